"""Places of higher interest, from markers: boxes and spheres with weights."""

from __future__ import annotations

import math
from typing import Any

from visualization_msgs.msg import Marker, MarkerArray

from infomap_ros.errors import FrameError, InvalidInputError, MalformedMessageError
from infomap_ros.geometry import Box, PlacedSolid, Sphere, transform_from_quaternion
from infomap_ros.views.situation import Interest

_TYPE = "visualization_msgs/msg/Marker"


class Interests:
    """The places that are of interest now; markers add, replace and delete them.

    A marker is a CUBE or a SPHERE (of its smallest diameter); its weight, the factor by which the
    information inside counts, is the number in its text. DELETE takes the marker of that namespace
    and id away, DELETEALL all.

    Args:
        map_frame: frame in which the markers must be.
    """

    def __init__(self, map_frame: str) -> None:
        self._map_frame = map_frame
        self._places: dict[tuple[str, int], Interest] = {}

    def current(self) -> tuple[Interest, ...]:
        """All places."""
        return tuple(self._places.values())

    def update(self, message: MarkerArray) -> None:
        """Take a message; it counts as a whole or not at all.

        Raises:
            MalformedMessageError: a marker is of another type or its numbers are impossible.
            FrameError: a marker is in another frame than the map's.
        """
        places = dict(self._places)
        for marker in message.markers:
            if marker.action == Marker.DELETEALL:
                places.clear()
            elif marker.action == Marker.DELETE:
                places.pop((marker.ns, marker.id), None)
            else:
                places[marker.ns, marker.id] = self._read(marker)
        self._places = places

    def _read(self, marker: Any) -> Interest:
        if marker.header.frame_id != self._map_frame:
            raise FrameError(
                f"interest in frame '{marker.header.frame_id}', the map is '{self._map_frame}'"
            )
        position, q = marker.pose.position, marker.pose.orientation
        sides = (marker.scale.x, marker.scale.y, marker.scale.z)
        try:
            pose = transform_from_quaternion(
                (q.x, q.y, q.z, q.w), (position.x, position.y, position.z)
            )
            solid = _solid(marker.type, sides)
            weight = float(marker.text)
            if not math.isfinite(weight):
                raise ValueError(f"weight {weight}")
            return Interest(PlacedSolid(solid, pose, f"{marker.ns}/{marker.id}"), weight)
        except (InvalidInputError, ValueError) as error:
            raise MalformedMessageError(_TYPE, f"{marker.ns}/{marker.id}: {error}") from error


def _solid(kind: int, sides: tuple[float, float, float]) -> Box | Sphere:
    if kind == Marker.CUBE:
        return Box(sides)
    if kind == Marker.SPHERE:
        return Sphere(0.5 * min(sides))
    raise ValueError(f"type {kind}, expected CUBE or SPHERE")
