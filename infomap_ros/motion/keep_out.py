"""What a robot must keep out of and the map does not show: other robots, regions, geofences.

Regions and fences hold for all that drives: body, wheels, and the arm in its posture for driving.
Where the base stands, arm and camera may reach over them.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from infomap_ros.errors import InvalidInputError
from infomap_ros.geometry import Cylinder, PlacedSolid, Polygon, make_transform
from infomap_ros.mapping.terrain.terrain import ClosedGround, Terrain
from infomap_ros.motion.base.vehicle import VehicleConfig

_ABOVE, _BELOW = 2.0, 0.5  # ground so far below or above an obstacle has nothing to do with it [m]


@dataclass(frozen=True)
class Obstacle:
    """An upright cylinder that is in the way.

    Attributes:
        x: of its axis [m, map].
        y: of its axis [m, map].
        radius: [m].
        bottom: z of its lower end [m, map].
        top: z of its upper end [m, map].
        name: what it is, for reasons.

    Raises:
        InvalidInputError: it is no cylinder.
    """

    x: float
    y: float
    radius: float
    bottom: float
    top: float
    name: str = ""

    def __post_init__(self) -> None:
        numbers = (self.x, self.y, self.radius, self.bottom, self.top)
        if not np.isfinite(numbers).all() or self.radius <= 0.0 or self.top <= self.bottom:
            raise InvalidInputError("obstacle", f"(x, y, radius, bottom, top) = {numbers}")

    @property
    def solid(self) -> PlacedSolid:
        """The same in the map's frame."""
        middle = (self.x, self.y, 0.5 * (self.bottom + self.top))
        body = Cylinder(self.radius, self.top - self.bottom)
        return PlacedSolid(body, make_transform(np.eye(3), middle), self.name)


def with_obstacles(terrain: Terrain, obstacles: Sequence[Obstacle]) -> Terrain:
    """A terrain whose columns are not open where obstacles stand.

    Args:
        terrain: the ground as the map shows it.
        obstacles: a cell any part of which lies in one is closed, unless its ground is on another
            level.

    Returns:
        A changed copy; the terrain itself without obstacles.
    """
    if not obstacles:
        return terrain
    names = ("heights", "floor", "overhead", "seen")
    changed = dataclasses.replace(terrain, **{n: getattr(terrain, n).copy() for n in names})
    for obstacle in obstacles:
        _close(changed, obstacle)
    return changed


def _close(terrain: Terrain, obstacle: Obstacle) -> None:
    reach = obstacle.radius + terrain.resolution / np.sqrt(2.0)
    corner = np.array([[obstacle.x - reach, obstacle.y - reach]])
    low = np.clip(terrain.cells_of(corner)[0], 0, terrain.heights.shape)
    high = np.clip(terrain.cells_of(corner + 2.0 * reach)[0] + 1, 0, terrain.heights.shape)
    cells = np.argwhere(np.ones(np.maximum(high - low, 0), np.bool_)) + low
    away = np.linalg.norm(terrain.centers_of(cells) - (obstacle.x, obstacle.y), axis=1)
    i, j = cells[away <= reach].T
    ground = terrain.heights[i, j]
    level = np.isnan(ground)
    level |= (ground > obstacle.bottom - _ABOVE) & (ground < obstacle.top + _BELOW)
    i, j = i[level], j[level]
    terrain.heights[i, j] = np.nan
    terrain.floor[i, j] = np.inf
    terrain.overhead[i, j] = terrain.seen[i, j] = np.float32(obstacle.bottom - _ABOVE)


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
