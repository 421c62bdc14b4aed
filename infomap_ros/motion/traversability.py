"""Where a vehicle can stand, as a grid for planners that move a point, and what it has to see."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt

from infomap_ros.geometry import Box, PlacedSolid, make_transform
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.mapping.files.projection import FREE, OCCUPIED, UNKNOWN, ProjectedGrid
from infomap_ros.mapping.terrain.terrain import Terrain
from infomap_ros.motion.base import stance
from infomap_ros.motion.base.vehicle import Vehicle

_HEADINGS = np.arange(8) * (np.pi / 4.0)  # [rad]
_AHEAD = 1.5  # [m] from where the base can go, in which what was never seen matters
_TILE = 0.5  # [m]; edge of the boxes about what was never seen
_NOT_KNOWN = (stance.OUTSIDE, stance.UNKNOWN_WHEEL, stance.UNKNOWN_BODY, stance.UNSEEN)


def traversability(terrain: Terrain, vehicle: Vehicle) -> ProjectedGrid:
    """Whether a vehicle can stand with its base at each cell's middle.

    Steps, slope, roughness, tipping over, ground clearance and what the body would touch count, as
    where the base is planned (Fig. 3 of Sujan and Dubowsky 2005). A cell's value is the share of
    eight headings in which it cannot stand, of those of which that is known, in percent; UNKNOWN
    where it is of none. The vehicle's extent is in the cells already.

    Args:
        terrain: the ground.
        vehicle: what drives.
    """
    cells = np.argwhere(np.isfinite(terrain.heights))
    grid = np.full(terrain.heights.shape, UNKNOWN, np.int8)
    if len(cells):
        places = np.empty((len(cells), len(_HEADINGS), 3))
        places[:, :, :2] = terrain.centers_of(cells)[:, None]
        places[:, :, 2] = _HEADINGS
        outcomes = vehicle.stances(terrain, places.reshape(-1, 3)).outcomes
        grid[cells[:, 0], cells[:, 1]] = _values(outcomes.reshape(len(cells), -1))
    return ProjectedGrid(np.ascontiguousarray(grid.T), terrain.origin, terrain.resolution)


def unseen_above(terrain: Terrain, area: NDArray[np.bool_], height: float) -> list[PlacedSolid]:
    """Space near by that only has to be seen for a vehicle to drive there: boxes about it [map].

    Over ground that is known, between the height up to which the space above it was seen and that
    of the vehicle, where nothing is known to hang so low.

    Args:
        terrain: the ground.
        area: where the base can go, on the terrain's cells.
        height: of the vehicle [m].
    """
    top = terrain.heights + height
    unseen = (terrain.seen < top) & (terrain.overhead > top)  # False where no ground is known
    if not (unseen.any() and area.any()):
        return []
    unseen &= distance_transform_edt(~area) * terrain.resolution < _AHEAD
    cells = np.argwhere(unseen)
    places, rows = terrain.centers_of(cells), tuple(cells.T)
    low, high = np.maximum(terrain.seen[rows], terrain.heights[rows]), top[rows]
    tiles, owners = np.unique(np.floor(places / _TILE), axis=0, return_inverse=True)
    return [
        _box((tile + 0.5) * _TILE, float(low[of].min()), float(high[of].max()))
        for number, tile in enumerate(tiles)
        for of in [owners.ravel() == number]
    ]


def _box(middle: FloatArray, low: float, high: float) -> PlacedSolid:
    """An upright box about a place, shape (2,), between two heights [m]."""
    center = make_transform(np.eye(3), (*middle, 0.5 * (low + high)))
    return PlacedSolid(Box((_TILE, _TILE, high - low)), center, "never seen")


def _values(outcomes: NDArray[np.int64]) -> NDArray[np.int8]:
    """Values of cells, shape (K,), of the outcomes in all headings, shape (K, H)."""
    known = (~np.isin(outcomes, _NOT_KNOWN)).sum(axis=1)
    refused = known - (outcomes == stance.STANDS).sum(axis=1)
    share = np.round((OCCUPIED - FREE) * refused / np.maximum(known, 1)) + FREE
    return np.where(known > 0, share, UNKNOWN).astype(np.int8)
