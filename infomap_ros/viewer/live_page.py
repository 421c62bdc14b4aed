"""The page of one run."""

from __future__ import annotations

import contextlib
import errno
import hmac
import importlib
import io
import secrets
import socket
import threading
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any
from urllib.parse import parse_qs, urlsplit

import numpy as np
from numpy.typing import NDArray

from infomap_ros.errors import ConfigError, InfomapError, MissingExtraError
from infomap_ros.exploration.reports.report_page.scene import (
    COLOR_MAPS,
    LOG_ODDS_RANGE,
    SIGMA_RANGE,
    DrawnSurface,
    drawn_surface,
    scene_of,
)
from infomap_ros.geometry import PinholeCamera
from infomap_ros.geometry.config import check_config, parameter
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.mapping import VoxelMap
from infomap_ros.motion.robot.robot_model import RobotModel
from infomap_ros.team.agents import Agent
from infomap_ros.viewer.run_panel import InterestBox, InterestControls, RunPanel
from infomap_ros.viewer.shapes import (
    CAMERA_PATH,
    ROBOT,
    TEAM,
    colored,
    draw_path,
    draw_solid,
    frustum,
    gradient,
    place,
)
from infomap_ros.viewer.views_layer import ViewsLayer

_MOST_VOXELS = 120_000  # more are merged to larger ones: each change is sent as a whole
_LIGHT = np.array([0.35, 0.2, 0.92])  # from where it comes, map frame
_SHADE = 0.6  # brightness of what is turned away from the light
_NAME = "/map"
_EVERYTHING = 1e6  # height above which nothing is hidden [m]


class MapLayer:
    """Draws the surface voxels, colored by what the user picks.

    Args:
        viser: the server.
    """

    def __init__(self, viser: Any) -> None:
        self._viser, self._lock = viser, threading.Lock()
        self._surface: DrawnSurface | None = None
        self._middle, self._has_been_shown = np.zeros(3), False
        gui = viser.gui
        self._color = gui.add_dropdown(
            "Color", ("height", "sigma", "probability"), hint="what the colors of the map show"
        )
        self._legend = gui.add_html("")
        self._cut = gui.add_slider(
            "Cut above [m]", -1.0, 5.0, 0.05, 5.0, hint="hides ceilings and tall walls"
        )
        for control in (self._color, self._cut):
            control.on_update(self._on_control)

    def _on_control(self, event: Any) -> None:
        """Draw anew what a user has changed; what this layer itself sets is drawn anyway."""
        if event.client is not None:
            self._draw()

    @property
    def middle(self) -> FloatArray:
        """Of what is shown, shape (3,) [m, map]."""
        with self._lock:
            return self._middle.copy()

    def show(self, voxel_map: VoxelMap) -> None:
        """Show the surface as it is now; called by one thread at a time."""
        surface = drawn_surface(voxel_map, _MOST_VOXELS)
        with self._lock:
            self._surface = surface
        self._draw()

    def _draw(self) -> None:
        with self._lock:
            if self._surface is None or not len(self._surface.cells):
                return
            self._draw_surface(self._surface)

    def _draw_surface(self, surface: DrawnSurface) -> None:
        manifest = scene_of(surface, None, None)["manifest"]
        low, high = manifest["focus"]
        self._adjust_to(np.array(low), np.array(high))
        centers = surface.centers
        cut = self._cut.value if self._cut.value < self._cut.max else _EVERYTHING
        shown = (surface.evidence >= surface.min_evidence) & (centers[:, 2] <= cut)
        colors = self._colors(surface, centers, manifest)
        shades = np.clip(surface.normals / 127.0 @ _LIGHT, 0.0, 1.0)
        lit = colors * (_SHADE + (1.0 - _SHADE) * shades[:, None])
        self._viser.scene.add_point_cloud(
            _NAME,
            centers[shown].astype(np.float32),
            lit[shown].astype(np.uint8),
            point_size=surface.size,
            point_shape="square",
            point_shading="flat",
            precision="float32",
        )

    def _colors(
        self, surface: DrawnSurface, centers: FloatArray, manifest: dict[str, Any]
    ) -> NDArray[np.uint8]:
        """Color of each voxel, and the legend to them."""
        kind = str(self._color.value)
        name = COLOR_MAPS[kind]
        if kind == "height":
            low, high = manifest["heights"]
            values, ends = centers[:, 2], (f"{low:.2f} m", f"{high:.2f} m")
        elif kind == "sigma":
            low, high = np.log(manifest["sigma"]["shown"])
            first, last = np.log(SIGMA_RANGE)
            values = first + surface.sigmas / 255.0 * (last - first)
            ends = (f"{1e3 * np.exp(low):.1f} mm", f"{1e3 * np.exp(high):.1f} mm")
        else:
            low, high = LOG_ODDS_RANGE
            values = low + surface.evidence / 255.0 * (high - low)
            ends = ("50 %", f"{100.0 / (1.0 + np.exp(-high)):.2f} %")
        self._legend.content = (
            '<div style="padding:0 0.6em 0.4em;font-size:0.75em">'
            f'<div style="height:0.7em;border-radius:3px;background:{gradient(name)}"></div>'
            f'<span>{ends[0]}</span><span style="float:right">{ends[1]}</span></div>'
        )
        return colored(values, low, high, name)

    def _adjust_to(self, low: FloatArray, high: FloatArray) -> None:
        """Look at the map from aside when there is one for the first time; let the cut reach it."""
        self._middle = 0.5 * (low + high)
        step = self._cut.step
        least, most = (float(step * round(end / step)) for end in (low[2] - 0.1, high[2] + 0.3))
        if least < self._cut.min or most > self._cut.max or not self._has_been_shown:
            is_open = self._cut.value >= self._cut.max
            self._cut.min, self._cut.max = least, most
            self._cut.value = most if is_open else min(self._cut.value, most)
        if self._has_been_shown:
            return
        self._has_been_shown = True
        middle, reach = self._middle, float(np.linalg.norm(high - low))
        place = middle + max(reach, 1.0) * np.array([-0.3, -0.42, 0.45])
        self._viser.initial_camera.look_at = tuple(middle)
        self._viser.initial_camera.position = tuple(place)
        for client in self._viser.get_clients().values():
            client.camera.position, client.camera.look_at = place, middle


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
        0, "Port of the page; 0: any that is free, named in the log.", low=0, high=65535
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


_ABOVE = 0.2  # the body, of what it does in words [m]


class TeamLayer:
    """Draws the other robots of a team.

    Args:
        viser: the server.
    """

    def __init__(self, viser: Any) -> None:
        self._scene = viser.scene
        self._shown: set[int] = set()

    def show(self, mates: Sequence[Agent]) -> None:
        """Show those that are known now, and no others."""
        for robot in self._shown - {mate.robot for mate in mates}:
            self._scene.remove_by_name(f"/team/{robot}")
        self._shown = {mate.robot for mate in mates}
        for mate in mates:
            self._draw(mate)

    def _draw(self, mate: Agent) -> None:
        name, color = f"/team/{mate.robot}", TEAM[mate.robot % len(TEAM)]
        place: FloatArray = mate.T_map_base[:3, 3]
        middle = place + np.array([0.0, 0.0, 0.5 * (mate.bottom + mate.top)])
        height = max(mate.top - mate.bottom, 0.01)
        scene = self._scene
        scene.add_frame(name, show_axes=False)
        scene.add_cylinder(
            f"{name}/body", max(mate.radius, 0.01), height, color=color, opacity=0.4,
            position=tuple(middle),
        )  # fmt: skip
        above = place + np.array([0.0, 0.0, mate.top + _ABOVE])
        scene.add_label(f"{name}/state", f"{mate.robot}: {mate.state}", position=tuple(above))
        ground = np.column_stack([mate.path[:, :2], np.full(len(mate.path), place[2])])
        draw_path(scene, f"{name}/path", ground, color)


_LEAST_STEP = 0.02  # of the camera's path: points closer than this are left out [m]
_LONGEST_PATH = 4000  # points of the camera's path that are kept


class RobotLayer:
    """Draws the robot, its camera, and the path that this has come.

    Args:
        viser: the server.
    """

    def __init__(self, viser: Any) -> None:
        self._scene = viser.scene
        self._robot: RobotModel | None = None
        self._parts: list[Any] = []
        self._camera: Any = None
        self._path: list[FloatArray] = []

    def show(self, robot: RobotModel, T_map_base: FloatArray, joints: Mapping[str, float]) -> None:
        """Place the robot.

        Args:
            robot: that it is.
            T_map_base: pose of its base, shape (4, 4).
            joints: positions by name [rad or m].
        """
        if robot is not self._robot:
            self._make(robot)
        try:
            solids = robot.solids_in(robot.base_frame, joints)
        except InfomapError:  # a joint has not been heard of yet
            return
        for part, solid in zip(self._parts, solids, strict=True):
            place(part, T_map_base @ solid.transform)

    def show_camera(self, T_map_camera: FloatArray, camera: PinholeCamera | None) -> None:
        """Place the camera: a pyramid along its optical axis, and the path that it has come.

        Args:
            T_map_camera: of its optical frame, shape (4, 4).
            camera: tells how far the pyramid opens; None where that is not known.
        """
        if self._camera is None:
            self._camera = frustum(self._scene, "/camera", camera, CAMERA_PATH)
        place(self._camera, T_map_camera)
        here = T_map_camera[:3, 3].copy()
        if self._path and np.linalg.norm(here - self._path[-1]) < _LEAST_STEP:
            return
        self._path.append(here)
        if len(self._path) > _LONGEST_PATH:
            self._path = [*self._path[: _LONGEST_PATH // 2 : 2], *self._path[_LONGEST_PATH // 2 :]]
        draw_path(self._scene, "/camera_path", self._path, CAMERA_PATH)

    def _make(self, robot: RobotModel) -> None:
        """Make the parts of the robot, all at the origin."""
        for part in self._parts:
            part.remove()
        self._robot, self._parts = robot, []
        for number, shape in enumerate(robot.shapes):
            self._parts.append(draw_solid(self._scene, f"/robot/{number}", shape, ROBOT))


# The address holds a token. A browser shows it to the server when it asks for the data, so
# neither another user of the machine nor a foreign web page, which may ask any address, gets in;
# a foreign page that has got hold of the token is refused by its origin.

_NOT_ALLOWED = 4403  # status of a closed WebSocket: an application's own numbers begin at 4000
_EVERYWHERE = ("", "0.0.0.0", "::")


class WebServer:
    """Serves a viser scene.

    Args:
        title: above the controls.
        host: address to listen at; 127.0.0.1 for this machine alone.
        port: to listen at; 0 for any that is free.

    Attributes:
        viser: the server, with its ``scene`` and ``gui``.
        address: to open in a browser, with the token.

    Raises:
        MissingExtraError: viser is not installed.
        ConfigError: host or port cannot be listened at.
    """

    def __init__(self, title: str, host: str, port: int) -> None:
        viser = _viser()
        _check_free(host, port)
        self._token = secrets.token_urlsafe(16)
        with contextlib.redirect_stdout(io.StringIO()):
            self.viser = viser.ViserServer(host, port, label=title, verbose=False)
        # viser has no access control: what it asks before it tells anything to a browser.
        self._connections = self.viser._websock_server
        self._connections.on_client_connect(self._admit)
        self._connections.disconnect_all_clients()  # who came before that
        name = socket.gethostname() if host in _EVERYWHERE else host
        place = f"{name}:{self.viser.get_port()}"
        self.address = f"http://{place}/?websocket=ws://{place}/?token={self._token}"

    @property
    def is_watched(self) -> bool:
        """Whether a browser shows the page."""
        return bool(self.viser.get_clients())

    def close(self) -> None:
        """End it."""
        self.viser.stop()

    async def _admit(self, client: Any) -> None:
        """Close a connection that does not show the token, or that another page has opened."""
        connection = self._connections._live_connections[client.client_id]
        headers, query = connection.request.headers, urlsplit(connection.request.path).query
        shown = parse_qs(query).get("token", [""])[0]
        origin = headers.get("Origin")  # browsers say it, other programs need not
        is_own = origin is None or urlsplit(origin).netloc == headers.get("Host")
        if not (is_own and hmac.compare_digest(shown.encode(), self._token.encode())):
            await connection.close(_NOT_ALLOWED, "open the whole address, with its token")
            # What came before the connection was closed would still be handled, buttons too.
            with contextlib.suppress(importlib.import_module("websockets").ConnectionClosed):
                while True:
                    await connection.recv()


def _viser() -> Any:
    try:
        found = importlib.import_module("viser")
    except ImportError as error:
        raise MissingExtraError("viewer", "viser") from error
    importlib.import_module("rich").get_console().quiet = True  # where viser alone prints
    return found


def _check_free(host: str, port: int) -> None:
    """Refuse an address that cannot be listened at; viser would take another port."""
    try:
        family, *_, place = socket.getaddrinfo(host or None, port, type=socket.SOCK_STREAM)[0]
        with socket.socket(family, socket.SOCK_STREAM) as trial:
            trial.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            trial.bind(place)
    except OSError as error:
        taken = error.errno in (errno.EADDRINUSE, errno.EACCES)
        expected = f"a place to serve the page at ({error.strerror or error})"
        if taken:
            raise ConfigError("port", port, expected) from error
        raise ConfigError("host", host, expected) from error
