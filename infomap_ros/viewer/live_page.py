"""The page of one run."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from infomap_ros.errors import ConfigError
from infomap_ros.geometry.config import check_config, parameter
from infomap_ros.viewer.interest_box import InterestBox, InterestControls
from infomap_ros.viewer.map_layer import MapLayer
from infomap_ros.viewer.robot_layer import RobotLayer
from infomap_ros.viewer.run_panel import RunPanel
from infomap_ros.viewer.team_layer import TeamLayer
from infomap_ros.viewer.views_layer import ViewsLayer
from infomap_ros.viewer.web_server import WebServer


@dataclass(frozen=True)
class PageConfig:
    """Where the page is served.

    Raises:
        ConfigError: a value is out of its range.
    """

    host: str = parameter(
        "127.0.0.1",
        "Address at which the page is served: 127.0.0.1 for this machine alone, 0.0.0.0 for all "
        "that reach it. In any case a browser needs the whole address, with its token.",
    )
    port: int = parameter(
        0, "Port of the page; 0: any that is free, which the log tells.", low=0, high=65535
    )

    read_only: bool = parameter(
        False, "Whoever opens the page may look, not steer: it has no buttons and no interest."
    )

    def __post_init__(self) -> None:
        check_config(self)
        if not self.host.isprintable() or " " in self.host:
            raise ConfigError("host", self.host, "the name or address of this machine")


class LivePage:
    """Serves a page, and changes it as it is told. All methods may be called by any thread.

    Args:
        title: of the run.
        config: where it is served.
        orders: buttons that steer the run, by their labels; an order returns its answer, or raises
            an error of the library. A page that is read only has none.
        on_interest: given a box that the user has placed, None where it is taken away; without it,
            or where it is read only, the page has no such control.
        has_plans: whether views are chosen in this run; else nothing is said of them.

    Attributes:
        map, robot, views, team, panel: its parts.

    Raises:
        MissingExtraError: viser is not installed.
        ConfigError: the address cannot be listened at.
    """

    def __init__(
        self,
        title: str,
        config: PageConfig | None = None,
        orders: Mapping[str, Callable[[], str]] | None = None,
        on_interest: Callable[[InterestBox | None], None] | None = None,
        *,
        has_plans: bool = True,
    ) -> None:
        settings = config or PageConfig()
        self._server = WebServer(title, settings.host, settings.port)
        viser = self._server.viser
        viser.gui.configure_theme(show_logo=False, show_share_button=False)
        viser.scene.add_frame("/map_frame", axes_length=0.5, axes_radius=0.01)
        self.panel = RunPanel(viser, {} if settings.read_only else orders or {})
        with viser.gui.add_folder("Map"):
            self.map = MapLayer(viser)
        with viser.gui.add_folder("Why this view", visible=has_plans):
            self.views = ViewsLayer(viser)
        if on_interest is not None and not settings.read_only:
            with viser.gui.add_folder("Place of interest", expand_by_default=False):
                InterestControls(viser, on_interest, lambda: self.map.middle)
        with viser.gui.add_folder("Log"):
            self.panel.add_log()
        self.robot, self.team = RobotLayer(viser), TeamLayer(viser)

    @property
    def address(self) -> str:
        """To open in a browser; it holds the token without which nobody gets in."""
        return self._server.address

    @property
    def is_watched(self) -> bool:
        """Whether a browser shows the page, so that it is worth drawing a map."""
        return self._server.is_watched

    def close(self) -> None:
        """End the page."""
        self._server.close()
