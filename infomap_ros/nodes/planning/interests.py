"""Places of higher interest, from markers: boxes and spheres with weights."""

from __future__ import annotations

from typing import Any

from visualization_msgs.msg import Marker

from infomap_ros.errors import InvalidInputError, MalformedMessageError
from infomap_ros.geometry import Box, PlacedSolid, Sphere
from infomap_ros.nodes.planning.marker_set import MARKER, MarkerSet, pose_of
from infomap_ros.views.situation import Interest


class Interests(MarkerSet[Interest]):
    """The places that are of interest now; markers add, replace and delete them.

    A marker is a CUBE or a SPHERE (of its smallest diameter); its weight, the factor by which the
    information inside counts, is the number in its text.

    Args:
        map_frame: frame in which the markers must be.
    """

    def __init__(self, map_frame: str) -> None:
        super().__init__(map_frame, _place, "interest")


def _place(marker: Any) -> Interest:
    sides = (marker.scale.x, marker.scale.y, marker.scale.z)
    try:
        solid = _solid(marker.type, sides)
        placed = PlacedSolid(solid, pose_of(marker), f"{marker.ns}/{marker.id}")
        return Interest(placed, float(marker.text))
    except (InvalidInputError, ValueError) as error:
        raise MalformedMessageError(MARKER, f"{marker.ns}/{marker.id}: {error}") from error


def _solid(kind: int, sides: tuple[float, float, float]) -> Box | Sphere:
    if kind == Marker.CUBE:
        return Box(sides)
    if kind == Marker.SPHERE:
        return Sphere(0.5 * min(sides))
    raise ValueError(f"type {kind}, expected CUBE or SPHERE")
