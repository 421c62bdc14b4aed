"""A planar world: a grid of free and occupied cells, seen through a `VoxelMap` of one layer."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from infomap_ros.errors import InvalidInputError
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.mapping import VoxelMap, VoxelMapConfig
from infomap_ros.mapping.voxels.voxel_states import put_states, unknown_states

BoolArray = NDArray[np.bool_]

_CERTAIN = 20  # evidence of the true map [quanta]


@dataclass(frozen=True, eq=False)
class PlanarWorld:
    """What is to be explored.

    Attributes:
        name: for tables and files.
        kind: worlds of one kind are averaged.
        occupied: shape (nx, ny), bool; cell (i, j) spans from (i, j) to (i + 1, j + 1) cells. All
            around lies a wall one cell thick that is part of the grid.
        cell: edge of a cell [m].
        start: where the sensor starts, shape (2,) [m]; in a free cell.

    Raises:
        InvalidInputError: the border is open, or the start is not free.
    """

    name: str
    kind: str
    occupied: BoolArray
    cell: float
    start: FloatArray

    def __post_init__(self) -> None:
        grid = self.occupied
        border = np.concatenate([grid[0], grid[-1], grid[:, 0], grid[:, -1]])
        if not border.all():
            raise InvalidInputError("planar world", f"{self.name}: its border is not a wall")
        if grid[self.start_cell]:
            raise InvalidInputError("planar world", f"{self.name}: it starts in an obstacle")

    @property
    def start_cell(self) -> tuple[int, int]:
        """Cell of the start."""
        i, j = np.floor(np.asarray(self.start) / self.cell).astype(int)
        return int(i), int(j)

    @property
    def size(self) -> FloatArray:
        """Edges of the grid, shape (2,) [m]."""
        return np.array(self.occupied.shape) * self.cell

    @cached_property
    def mappable(self) -> BoolArray:
        """Cells that can be mapped from where the sensor can come to, shape (nx, ny).

        The free cells that are connected with the start over their edges, and the occupied ones
        that share an edge with them. Only these count in the fraction mapped.
        """
        labels, _ = ndimage.label(~self.occupied)
        free = labels == labels[self.start_cell]
        return np.asarray(free | (ndimage.binary_dilation(free) & self.occupied))

    @cached_property
    def truth(self) -> VoxelMap:
        """The occupied cells as a map of one layer, from which scans are taken."""
        cells = np.argwhere(self.occupied)
        indices = np.column_stack([cells, np.zeros(len(cells), int)]).astype(np.int32)
        voxel_map = VoxelMap(VoxelMapConfig(voxel_size=self.cell))
        states = unknown_states(indices)
        states.known[:] = True
        states.quanta[:] = _CERTAIN
        put_states(voxel_map._storage, states)
        return voxel_map

    def known_cells(self, voxel_map: VoxelMap) -> BoolArray:
        """Which cells a map knows, shape (nx, ny)."""
        centers = np.argwhere(np.ones(self.occupied.shape, np.bool_)) + 0.5
        places = np.column_stack([centers, np.full(len(centers), 0.5)]) * self.cell
        return voxel_map.is_known(places).reshape(self.occupied.shape)

    def fraction_mapped(self, voxel_map: VoxelMap) -> float:
        """Share of the mappable cells that a map knows, in [0, 1]."""
        known = self.known_cells(voxel_map)
        return float(np.count_nonzero(known & self.mappable) / np.count_nonzero(self.mappable))
