"""Where the base must not go, whatever the map shows: keep-out regions and geofences.

They hold for all that drives: body, wheels, and the arm in its posture for driving. Where the base
stands, arm and camera may reach over them.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from infomap_ros.geometry import Polygon
from infomap_ros.mapping.terrain.terrain import ClosedGround, Terrain
from infomap_ros.motion.base.vehicle_config import VehicleConfig

_BESIDE = VehicleConfig.column_spacing / np.sqrt(2.0)
"""Farthest that a point of the body lies from the middle of its column, which is what is compared
with the ground [m]."""


@dataclass(frozen=True)
class KeepOut:
    """Regions of which the base stays out, and fences within which it stays.

    Attributes:
        regions: polygons in the map.
        fences: likewise; the base stays within each.
    """

    regions: tuple[Polygon, ...] = ()
    fences: tuple[Polygon, ...] = ()

    @property
    def is_empty(self) -> bool:
        """Whether the base may be everywhere."""
        return not self.regions and not self.fences

    def with_others(self, other: KeepOut) -> KeepOut:
        """What keeps to both."""
        return KeepOut(self.regions + other.regions, self.fences + other.fences)

    def closed_ground(self, terrain: Terrain) -> list[ClosedGround]:
        """Cells with any point so near that a body could be where it must not.

        So a base keeps up to 0.17 m off: the middle of a column may lie 0.055 m beside the body,
        and 0.11 m from the region, with cells of 0.05 m. One entry for each region and then for
        each fence, also where it closes nothing.
        """
        if self.is_empty:
            return []
        cells = np.indices(terrain.heights.shape).transpose(1, 2, 0)
        middles = terrain.centers_of(cells)
        reach = _BESIDE + terrain.resolution / np.sqrt(2.0)
        closed = []
        for each in self.regions:
            where = f"in or next to keep-out region '{each.name}'"
            closed.append(ClosedGround(where, each.signed_distance(middles) < reach))
        for each in self.fences:
            where = f"outside or next to geofence '{each.name}'"
            closed.append(ClosedGround(where, each.signed_distance(middles) > -reach))
        return closed


def with_closed_ground(terrain: Terrain, closed: Iterable[ClosedGround]) -> Terrain:
    """A terrain in whose closed cells no part of a body has room.

    Args:
        terrain: the ground as the map shows it, with all else that changes it.
        closed: of `KeepOut.closed_ground` for it.

    Returns:
        A changed copy; heights stay. The terrain itself where nothing is closed.
    """
    effective = tuple(each for each in closed if each.cells.any())
    if not effective:
        return terrain
    shut = np.logical_or.reduce([each.cells for each in effective])
    overhead, seen = terrain.overhead.copy(), terrain.seen.copy()
    overhead[shut] = seen[shut] = -np.inf
    return dataclasses.replace(
        terrain, overhead=overhead, seen=seen, closed=(*terrain.closed, *effective)
    )


def with_keep_out(terrain: Terrain, keep_out: KeepOut) -> Terrain:
    """A terrain in which no body has room where it must not go; see `with_closed_ground`."""
    return with_closed_ground(terrain, keep_out.closed_ground(terrain))
