"""Where the base must not go, from the topics keep_out and geofence."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from geometry_msgs.msg import PolygonStamped
from visualization_msgs.msg import Marker, MarkerArray

from infomap_ros.errors import InvalidInputError, MalformedMessageError
from infomap_ros.geometry import Polygon, transform_points
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.motion.keep_out import KeepOut
from infomap_ros.nodes.common import qos
from infomap_ros.nodes.common.base import MonitoredNode
from infomap_ros.nodes.planning.marker_set import MARKER, MarkerSet, check_frame, pose_of

_POLYGON = "geometry_msgs/msg/PolygonStamped"
_UPRIGHT = 0.999  # cosine of the largest tilt of a region (2.6 degrees)


class KeepOutListener:
    """Keeps what was set last; a message that is refused changes nothing.

    keep_out (MarkerArray): a marker is a CUBE, seen from above, or a LINE_STRIP through the corners
    of a polygon. ADD sets the one of that namespace and id, DELETE takes it away, DELETEALL all.
    geofence (PolygonStamped): the one fence; without points none.

    Args:
        node: next_best_view.
        map_frame: frame in which both must be.
        on_change: called after each message that was taken.
    """

    def __init__(self, node: MonitoredNode, map_frame: str, on_change: Callable[[], None]) -> None:
        self._map_frame, self._on_change = map_frame, on_change
        self._regions = MarkerSet(map_frame, _region, "keep_out")
        self._fences: tuple[Polygon, ...] = ()
        latched = qos.latched()
        node.listen(MarkerArray, "keep_out", self.set_regions, latched, required=False)
        node.listen(PolygonStamped, "geofence", self.set_fence, latched, required=False)

    def current(self) -> KeepOut:
        """What was set last."""
        return KeepOut(self._regions.current(), self._fences)

    def set_regions(self, message: MarkerArray) -> None:
        """Take markers; they count together or not at all.

        Raises:
            MalformedMessageError: a marker is no region.
            FrameError: one is in another frame than the map's.
        """
        self._regions.update(message)
        self._on_change()

    def set_fence(self, message: PolygonStamped) -> None:
        """Take a fence, or none.

        Raises:
            MalformedMessageError: it is no polygon.
            FrameError: it is in another frame than the map's.
        """
        points = message.polygon.points
        if points:
            check_frame(message.header.frame_id, self._map_frame, "geofence")
        corners = [(point.x, point.y) for point in points]
        try:
            self._fences = (Polygon.of(corners, "of the topic"),) if points else ()
        except InvalidInputError as error:
            raise MalformedMessageError(_POLYGON, f"geofence: {error}") from error
        self._on_change()


def _region(marker: Any) -> Polygon:
    name = f"{marker.ns}/{marker.id}"
    try:
        pose = pose_of(marker)
        if pose[2, 2] < _UPRIGHT:
            raise ValueError("is tilted; regions are seen from above")
        corners = transform_points(pose, _corners(marker))
        return Polygon.of(corners[:, :2].tolist(), name)
    except (InvalidInputError, ValueError) as error:
        raise MalformedMessageError(MARKER, f"{name}: {error}") from error


def _corners(marker: Any) -> FloatArray:
    """Corners in the marker's frame, shape (N, 3) [m]."""
    if marker.type == Marker.CUBE:
        x, y = 0.5 * marker.scale.x, 0.5 * marker.scale.y
        if not (0.0 < x < np.inf and 0.0 < y < np.inf):
            raise ValueError(f"sides of {marker.scale.x} and {marker.scale.y} m")
        return np.array([[x, y, 0.0], [-x, y, 0.0], [-x, -y, 0.0], [x, -y, 0.0]])
    if marker.type == Marker.LINE_STRIP:
        return np.array([(p.x, p.y, p.z) for p in marker.points]).reshape(-1, 3)
    raise ValueError(f"type {marker.type}, expected CUBE or LINE_STRIP")
