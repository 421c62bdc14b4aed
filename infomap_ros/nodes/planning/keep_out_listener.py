"""Where the base must not go, from the topics keep_out and geofence.

What markers stand for now: they add, replace and delete it by namespace and id.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Generic, TypeVar

import numpy as np
from geometry_msgs.msg import PolygonStamped
from visualization_msgs.msg import Marker, MarkerArray

from infomap_ros.errors import FrameError, InvalidInputError, MalformedMessageError
from infomap_ros.geometry import Polygon, transform_from_quaternion, transform_points
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.motion.keep_out import KeepOut
from infomap_ros.nodes.common import qos
from infomap_ros.nodes.common.base import MonitoredNode

Item = TypeVar("Item")

MARKER = "visualization_msgs/msg/Marker"
"""Type of the messages, for errors."""
MOST_ITEMS = 1000


class MarkerSet(Generic[Item]):
    """DELETE takes the marker of that namespace and id away, DELETEALL all.

    Args:
        map_frame: frame in which the markers must be.
        read: what a marker stands for; raises `MalformedMessageError` where that is nothing.
        what: the markers are, for errors.
    """

    def __init__(self, map_frame: str, read: Callable[[Any], Item], what: str) -> None:
        self._map_frame, self._read, self._what = map_frame, read, what
        self._items: dict[tuple[str, int], Item] = {}

    def current(self) -> tuple[Item, ...]:
        """All that markers stand for."""
        return tuple(self._items.values())

    def update(self, message: MarkerArray) -> None:
        """Take a message; it counts as a whole or not at all.

        Raises:
            MalformedMessageError: a marker is of another type or its numbers are impossible, or
                there would be more than `MOST_ITEMS`.
            FrameError: a marker is in another frame than the map's.
        """
        items = dict(self._items)
        for marker in message.markers:
            if not f"{marker.ns}{marker.header.frame_id}".isprintable():
                raise MalformedMessageError(MARKER, f"{marker.ns!r} is no printable namespace")
            if marker.action == Marker.DELETEALL:
                items.clear()
            elif marker.action == Marker.DELETE:
                items.pop((marker.ns, marker.id), None)
            else:
                check_frame(marker.header.frame_id, self._map_frame, self._what)
                items[marker.ns, marker.id] = self._read(marker)
        if len(items) > MOST_ITEMS:
            raise MalformedMessageError(MARKER, f"{len(items)} of {self._what}, not {MOST_ITEMS}")
        self._items = items


def check_frame(frame: str, map_frame: str, what: str) -> None:
    """Refuse a message about another frame than the map's.

    Raises:
        FrameError: it is.
    """
    if frame != map_frame:
        raise FrameError(f"{what} in frame '{frame}', the map is '{map_frame}'")


def pose_of(marker: Any) -> FloatArray:
    """``T_map_marker``, shape (4, 4).

    Raises:
        InvalidInputError: a number is not finite, or the orientation is no rotation.
    """
    position, q = marker.pose.position, marker.pose.orientation
    return transform_from_quaternion((q.x, q.y, q.z, q.w), (position.x, position.y, position.z))


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
