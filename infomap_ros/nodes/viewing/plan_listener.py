"""What next_best_view and explorer tell, shown on a page."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import Path
from visualization_msgs.msg import Marker, MarkerArray

from infomap_ros.errors import MalformedMessageError
from infomap_ros.geometry import PinholeCamera
from infomap_ros.messages import decode_pose
from infomap_ros.nodes.common import qos
from infomap_ros.nodes.common.base import MonitoredNode
from infomap_ros.nodes.planning.plan_outputs import CANDIDATES, REJECTED
from infomap_ros.viewer import LivePage
from infomap_ros.viewer.run_panel import map_figures
from infomap_ros.viewer.views_layer import ConsideredView

_MARKERS = "visualization_msgs/msg/MarkerArray"
_SHARES = ("known fraction", "precise fraction")
_COUNTS = {"views": "views", "surface voxels": "surface voxels", "failures": "views in vain"}


class PlanListener:
    """Listens to view_candidates, next_view, the planned way and exploration_status.

    Args:
        node: that listens.
        page: where they are shown.
        planner: name of the node that plans.
        camera: the camera whose views they are; None where it is not known yet.
    """

    def __init__(
        self,
        node: MonitoredNode,
        page: LivePage,
        planner: str,
        camera: Callable[[], PinholeCamera | None],
    ) -> None:
        self._page, self._camera = page, camera
        self._state = self._reason = ""
        heard: tuple[tuple[type, str, Callable[[Any], None]], ...] = (
            (MarkerArray, "view_candidates", self._on_candidates),
            (PoseStamped, "next_view", self._on_view),
            (Path, f"{planner}/base_path", self._on_way),
            (DiagnosticStatus, "exploration_status", self._on_status),
        )
        for kind, topic, handle in heard:
            node.listen(kind, topic, handle, qos.latched(), required=False)

    def _on_candidates(self, message: MarkerArray) -> None:
        self._page.views.show(considered_views(message))

    def _on_view(self, message: PoseStamped) -> None:
        view = decode_pose(message).transform
        self._page.views.show_chosen(view, self._camera(), self._reason)

    def _on_way(self, message: Path) -> None:
        places = [decode_pose(each).transform[:3, 3] for each in message.poses]
        self._page.views.show_way(np.array(places).reshape(-1, 3))

    def _on_status(self, message: DiagnosticStatus) -> None:
        values = {pair.key: pair.value for pair in message.values}
        self._page.panel.show_state(message.message, _figures(values))
        reason = values.get("last reason", "")
        if reason != self._reason:
            self._reason = reason
            self._page.views.show_reason(reason)
            self._page.panel.say(reason)
        if message.message != self._state:
            self._state = message.message
            self._page.panel.say(message.message)
            known, precise = (_number(values.get(name, "")) for name in _SHARES)
            self._page.panel.add_point(known, precise)


def considered_views(message: MarkerArray) -> list[ConsideredView]:
    """The views of view_candidates.

    Raises:
        MalformedMessageError: a marker is not an arrow between two different points.
    """
    return [
        _considered(marker)
        for marker in message.markers
        if marker.action == Marker.ADD and marker.ns in (CANDIDATES, REJECTED)
    ]


def _considered(marker: Marker) -> ConsideredView:
    ends = np.array([(point.x, point.y, point.z) for point in marker.points])
    length = float(np.linalg.norm(ends[-1] - ends[0])) if ends.shape == (2, 3) else math.nan
    if not length > 0.0 or not math.isfinite(length):
        raise MalformedMessageError(_MARKERS, f"{marker.ns}/{marker.id} is not an arrow")
    color = np.nan_to_num([marker.color.r, marker.color.g, marker.color.b])
    red, green, blue = (int(share) for share in np.rint(255.0 * np.clip(color, 0.0, 1.0)))
    direction = (ends[1] - ends[0]) / length
    rejected = marker.ns == REJECTED
    return ConsideredView(ends[0], direction, (red, green, blue), marker.text, rejected)


def _figures(values: dict[str, str]) -> dict[str, str]:
    """Of exploration_status, as the page tells them."""
    figures = {name: values[key] for key, name in _COUNTS.items() if key in values}
    figures |= {"way": f"{values['distance [m]']} m"} if "distance [m]" in values else {}
    known, precise, sigma = (_number(values.get(key, "")) for key in (*_SHARES, "mean sigma [m]"))
    return figures | map_figures(known, precise, sigma)


def _number(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        return math.nan
