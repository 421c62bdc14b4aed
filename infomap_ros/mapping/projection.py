"""The map seen from above, as 2-D planners take it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from infomap_ros.errors import ConfigError
from infomap_ros.geometry.config import check_config, parameter
from infomap_ros.mapping.voxel_map import VoxelMap

UNKNOWN, FREE, OCCUPIED = -1, 0, 100
"""Values of a cell, as in ``nav_msgs/OccupancyGrid``."""


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
    occupied_probability: float = parameter(
        0.65, "A column is occupied if one of its voxels is at least so likely.", low=0.5, high=1.0
    )
    free_probability: float = parameter(
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
        config: height band and thresholds. A voxel belongs to the band with its centre.
    """
    band = config or ProjectionConfig()
    size = voxel_map.config.voxel_size
    indices, log_odds = voxel_map.voxels()
    heights = (indices[:, 2] + 0.5) * size
    chosen = (heights >= band.low) & (heights <= band.high)
    columns = indices[chosen, :2]
    if not len(columns):
        return ProjectedGrid(np.full((1, 1), UNKNOWN, dtype=np.int8), (0.0, 0.0), size)
    first = columns.min(axis=0)
    across, along = columns.max(axis=0) - first + 1
    highest = np.full((along, across), np.nan, dtype=np.float32)
    np.fmax.at(highest, (columns[:, 1] - first[1], columns[:, 0] - first[0]), log_odds[chosen])
    cells = np.full((along, across), UNKNOWN, dtype=np.int8)
    cells[highest >= _log_odds(band.occupied_probability)] = OCCUPIED
    cells[highest <= _log_odds(band.free_probability)] = FREE
    return ProjectedGrid(cells, (float(first[0] * size), float(first[1] * size)), size)


def _log_odds(probability: float) -> float:
    with np.errstate(divide="ignore"):
        return float(np.log(probability) - np.log1p(-probability))
