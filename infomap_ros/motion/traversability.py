"""Where a vehicle can stand, as a grid for planners that move a point."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from infomap_ros.mapping.files.projection import FREE, OCCUPIED, UNKNOWN, ProjectedGrid
from infomap_ros.mapping.terrain.terrain import Terrain
from infomap_ros.motion.base import stance
from infomap_ros.motion.base.vehicle import Vehicle

_HEADINGS = np.arange(8) * (np.pi / 4.0)  # [rad]
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


def _values(outcomes: NDArray[np.int64]) -> NDArray[np.int8]:
    """Values of cells, shape (K,), of the outcomes in all headings, shape (K, H)."""
    known = (~np.isin(outcomes, _NOT_KNOWN)).sum(axis=1)
    refused = known - (outcomes == stance.STANDS).sum(axis=1)
    share = np.round((OCCUPIED - FREE) * refused / np.maximum(known, 1)) + FREE
    return np.where(known > 0, share, UNKNOWN).astype(np.int8)
