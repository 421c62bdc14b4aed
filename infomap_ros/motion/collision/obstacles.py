"""Things that the map does not show and a robot must not touch, such as other robots."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from infomap_ros.errors import InvalidInputError
from infomap_ros.geometry import Cylinder, PlacedSolid, make_transform
from infomap_ros.mapping.terrain.terrain import Terrain

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
