"""What markers stand for now: they add, replace and delete it by namespace and id."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Generic, TypeVar

from visualization_msgs.msg import Marker, MarkerArray

from infomap_ros.errors import FrameError, MalformedMessageError
from infomap_ros.geometry import transform_from_quaternion
from infomap_ros.geometry.transforms import FloatArray

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
