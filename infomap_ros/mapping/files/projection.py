"""The map seen from above, as 2-D planners take it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from infomap_ros.errors import ConfigError
from infomap_ros.geometry.config import check_config, parameter, setting
from infomap_ros.mapping.config import LOG_ODDS_QUANTUM
from infomap_ros.mapping.voxel_map import VoxelMap
from infomap_ros.mapping.voxels.block_kernels import quanta_of
from infomap_ros.mapping.voxels.blocks import BLOCK_COUNT
from infomap_ros.mapping.voxels.keys import BLOCK_SIDE, local_index, unpack

UNKNOWN, FREE, OCCUPIED = -1, 0, 100
"""Values of a cell, as in ``nav_msgs/OccupancyGrid``."""

_NOTHING = -(2**31)


@dataclass(frozen=True)
class ProjectionConfig:
    """Which voxels stand in the way.

    Raises:
        ConfigError: a value is out of its range, or the band is empty.
    """

    low: float = parameter(
        0.1, "Lower end of the height band, map frame.", unit="m", low=-1e4, high=1e4
    )
    high: float = parameter(
        1.0, "Upper end of the height band, map frame.", unit="m", low=-1e4, high=1e4
    )
    occupied_probability: float = setting(
        0.65, "A column is occupied if one of its voxels is at least so likely.", low=0.5, high=1.0
    )
    free_probability: float = setting(
        0.25, "A column is free if none of its known voxels is more likely.", low=0.0, high=0.5
    )

    def __post_init__(self) -> None:
        check_config(self)
        if self.high <= self.low:
            raise ConfigError("high", self.high, f"more than low, {self.low} m")


@dataclass(frozen=True, eq=False)
class ProjectedGrid:
    """A grid of square cells, row by row from the lowest y.

    Attributes:
        cells: UNKNOWN, FREE or OCCUPIED, shape (rows along y, columns along x), int8.
        origin: x and y of the outer corner of cell (0, 0), map frame [m].
        resolution: edge of a cell [m].
    """

    cells: NDArray[np.int8]
    origin: tuple[float, float]
    resolution: float


def project_map(voxel_map: VoxelMap, config: ProjectionConfig | None = None) -> ProjectedGrid:
    """Project the voxels of a height band onto the ground plane.

    A column with evidence between the two thresholds is unknown, as are those without any. The
    grid just holds the columns that were observed; an empty map gives one unknown cell.

    Args:
        voxel_map: the map.
        config: height band and thresholds. A voxel belongs to the band with its center.
    """
    band = config or ProjectionConfig()
    size = voxel_map.config.voxel_size
    highest, first = _highest_in_band(voxel_map, band)
    cells = np.full(highest.shape, UNKNOWN, dtype=np.int8)
    known, log_odds = highest > _NOTHING, highest * LOG_ODDS_QUANTUM
    cells[known & (log_odds >= _log_odds(band.occupied_probability))] = OCCUPIED
    cells[known & (log_odds <= _log_odds(band.free_probability))] = FREE
    return ProjectedGrid(cells, (first[0] * size, first[1] * size), size)


def _highest_in_band(
    voxel_map: VoxelMap, band: ProjectionConfig
) -> tuple[NDArray[np.int32], tuple[int, int]]:
    """Most evidence in each column [quanta], rows along y, and x and y index of the first one."""
    bounds = voxel_map.bounds()
    if bounds is None:
        return np.full((1, 1), _NOTHING, np.int32), (0, 0)
    low, high = bounds
    size = voxel_map.config.voxel_size
    levels = np.arange(low[2], high[2] + 1)
    heights = (levels + 0.5) * size
    levels = levels[(heights >= band.low) & (heights <= band.high)]
    highest = np.full((high[1] - low[1] + 1, high[0] - low[0] + 1), _NOTHING, np.int32)
    if len(levels):
        blocks = voxel_map._storage.blocks
        _project(blocks, low[0], low[1], levels[0], levels[-1], highest)
    rows, columns = (np.flatnonzero((highest > _NOTHING).any(axis=axis)) for axis in (1, 0))
    if not len(rows):
        return highest[:1, :1], (0, 0)
    trimmed = highest[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]
    return trimmed, (int(low[0] + columns[0]), int(low[1] + rows[0]))


@njit(cache=True, nogil=True)
def _project(
    blocks: Any, first_x: int, first_y: int, lowest: int, topmost: int, highest: Any
) -> None:
    """Raise the columns to the evidence of the known voxels from level `lowest` to `topmost`."""
    kinds, bases, planes = blocks.kind, blocks.base, blocks.plane
    keys, narrow, wide = blocks.keys, blocks.narrow, blocks.wide
    for slot in range(blocks.counts[BLOCK_COUNT]):
        x, y, z = unpack(keys[slot])
        x, y, z = x * BLOCK_SIDE - first_x, y * BLOCK_SIDE - first_y, z * BLOCK_SIDE
        for level in range(max(z, lowest), min(z + BLOCK_SIDE, topmost + 1)):
            for row in range(BLOCK_SIDE):
                for column in range(BLOCK_SIDE):
                    local = local_index(column, row, level)
                    known, quanta = quanta_of(
                        kinds[slot], bases[slot], planes[slot], narrow, wide, local
                    )
                    if known and quanta > highest[y + row, x + column]:
                        highest[y + row, x + column] = quanta


def _log_odds(probability: float) -> float:
    with np.errstate(divide="ignore"):
        return float(np.log(probability) - np.log1p(-probability))
