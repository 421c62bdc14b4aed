"""A dense copy of a box of the map, for what looks at many voxels of one neighborhood."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray
from scipy.ndimage import convolve1d, maximum_filter

from infomap_ros.errors import ConfigError, InvalidInputError
from infomap_ros.geometry import float_array
from infomap_ros.geometry.config import check_config, parameter
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.mapping.config import LOG_ODDS_QUANTUM
from infomap_ros.mapping.voxels.block_kernels import find_block, quanta_of
from infomap_ros.mapping.voxels.keys import (
    BLOCK_BITS,
    BLOCK_SIDE,
    COORDINATE_LIMIT,
    UNSEEN,
    local_index,
    pack,
)

UNKNOWN, FREE, UNCERTAIN, OCCUPIED = 0, 1, 2, 3
"""States of a voxel in `VoxelWindow.states`."""

UNKNOWN_QUANTA = -32768
"""Evidence of a voxel that was never observed, in `VoxelWindow.quanta`."""

CONFIRMED_PROBABILITY = 0.95
"""A voxel more likely occupied than this was hit more than once: one hit of the default model says
0.9. What was hit once is a reason to look, and neither stops a motion nor fills a hole."""

_LARGEST = 1 << 30
_MOSTLY_FREE = 13  # of a voxel's 26 neighbors


@dataclass(frozen=True)
class OccupancyThresholds:
    """When a known voxel counts as free and when as occupied.

    Raises:
        ConfigError: a value is out of its range, or free is not below occupied.
    """

    free_probability: float = parameter(
        0.05,
        "A known voxel less likely occupied than this is free (2 sigma; Sujan and Dubowsky 2005).",
        low=1e-6,
        high=0.5,
    )
    occupied_probability: float = parameter(
        0.5, "A known voxel more likely occupied than this is occupied.", low=0.05, high=0.999
    )
    surface_margin: int = parameter(
        2,
        "A scan leaves the voxels right before a surface unobserved, as noise may have put them "
        "there. Unknown voxels with both an occupied and a free one within this many count as "
        "free.",
        unit="voxels",
        low=0,
        high=10,
    )

    def __post_init__(self) -> None:
        check_config(self)
        if self.free_probability >= self.occupied_probability:
            raise ConfigError("free_probability", self.free_probability, "below occupied")


@dataclass(frozen=True, eq=False)
class VoxelWindow:
    """The voxels of a box.

    Attributes:
        quanta: evidence in units of `LOG_ODDS_QUANTUM`, `UNKNOWN_QUANTA` where never observed,
            clipped to int16, indexed [x, y, z], shape (nx, ny, nz).
        first: voxel index of ``quanta[0, 0, 0]``, shape (3,).
        voxel_size: edge of a voxel [m].
    """

    quanta: NDArray[np.int16]
    first: NDArray[np.int64]
    voxel_size: float

    def states(self, thresholds: OccupancyThresholds | None = None) -> NDArray[np.uint8]:
        """UNKNOWN, FREE, UNCERTAIN (known, but between the thresholds) or OCCUPIED per voxel.

        A voxel that is not free with mostly free neighbors and no confirmed surface among them or
        in it is a hole in free space, and free: noise leaves such holes, and no body is so small.
        """
        limits = thresholds or OccupancyThresholds()
        free, occupied, confirmed = (
            float(np.log(p / (1.0 - p)) / LOG_ODDS_QUANTUM)
            for p in (
                limits.free_probability,
                limits.occupied_probability,
                max(CONFIRMED_PROBABILITY, limits.occupied_probability),
            )
        )
        states = np.full(self.quanta.shape, UNCERTAIN, np.uint8)
        states[self.quanta < free] = FREE
        states[self.quanta > occupied] = OCCUPIED
        states[self.quanta == UNKNOWN_QUANTA] = UNKNOWN
        _close_holes(states, self.quanta > confirmed)
        if limits.surface_margin:
            _close_margin(states, limits.surface_margin)
        return states

    def positions_of(self, points: ArrayLike) -> NDArray[np.int64]:
        """Array positions of the voxels that hold points, (N, 3) [m, map] -> (N, 3).

        Positions outside the array are returned as they are, below 0 or beyond the shape.
        """
        return np.floor(np.asarray(points) / self.voxel_size).astype(np.int64) - self.first

    def centers_of(self, positions: ArrayLike) -> FloatArray:
        """Centers of voxels given by their array positions, (N, 3) -> (N, 3) [m, map]."""
        return np.asarray((np.asarray(positions) + self.first + 0.5) * self.voxel_size)

    def contains(self, positions: ArrayLike) -> NDArray[np.bool_]:
        """Which array positions, shape (..., 3), lie in the array, shape (...)."""
        places = np.asarray(positions)
        return np.asarray(((places >= 0) & (places < self.quanta.shape)).all(axis=-1))


def _close_holes(states: NDArray[np.uint8], confirmed: NDArray[np.bool_]) -> None:
    """Turn what is not free into FREE where most neighbors are free and none is confirmed."""
    free = states == FREE
    neighbors = free.astype(np.uint8)
    for axis in range(3):
        neighbors = convolve1d(neighbors, [1, 1, 1], axis=axis, mode="constant")
    holes = ~free & (neighbors >= _MOSTLY_FREE)
    if holes.any():
        states[holes & ~maximum_filter(confirmed, size=3, mode="constant")] = FREE


def _close_margin(states: NDArray[np.uint8], margin: int) -> None:
    """Turn UNKNOWN into FREE where both OCCUPIED and FREE are within `margin` voxels."""
    width = 2 * margin + 1
    near_surface = maximum_filter(states == OCCUPIED, size=width, mode="constant")
    near_free = maximum_filter(states == FREE, size=width, mode="constant")
    states[(states == UNKNOWN) & near_surface & near_free] = FREE


def window_of(blocks: Any, voxel_size: float, low: ArrayLike, high: ArrayLike) -> VoxelWindow:
    """Copy the voxels that a box touches; the public form is `VoxelMap.window`."""
    corners = np.stack([float_array(low, "low"), float_array(high, "high")])
    if corners.shape != (2, 3) or not np.isfinite(corners).all() or (corners[1] < corners[0]).any():
        raise InvalidInputError("window", f"{corners.tolist()} is not a box")
    scaled = corners / voxel_size
    if np.abs(scaled).max() >= COORDINATE_LIMIT - 1:
        raise InvalidInputError("window", f"{corners.tolist()} leaves the map's limits")
    first = np.floor(scaled[0]).astype(np.int64)
    shape = np.maximum(np.ceil(scaled[1] - 1e-9).astype(np.int64) - first, 1)
    if float(np.prod(shape.astype(float))) > _LARGEST:
        raise InvalidInputError("window", f"of {shape.tolist()} voxels is too large")
    quanta = np.full(tuple(shape), UNKNOWN_QUANTA, np.int16)
    _fill(blocks, first, quanta)
    return VoxelWindow(quanta, first, voxel_size)


@njit(cache=True, nogil=True)
def _fill(blocks: Any, first: Any, quanta: Any) -> None:
    """Copy block by block what lies in the window."""
    nx, ny, nz = quanta.shape
    x0, y0, z0 = first[0], first[1], first[2]
    kinds, bases, rows = blocks.kind, blocks.base, blocks.plane
    narrow, wide = blocks.narrow, blocks.wide
    for bx in range(x0 >> BLOCK_BITS, ((x0 + nx - 1) >> BLOCK_BITS) + 1):
        for by in range(y0 >> BLOCK_BITS, ((y0 + ny - 1) >> BLOCK_BITS) + 1):
            for bz in range(z0 >> BLOCK_BITS, ((z0 + nz - 1) >> BLOCK_BITS) + 1):
                slot = find_block(blocks, pack(bx, by, bz))
                if slot >= 0 and kinds[slot] != UNSEEN:
                    x, y, z = bx * BLOCK_SIDE - x0, by * BLOCK_SIDE - y0, bz * BLOCK_SIDE - z0
                    base = np.int64(bases[slot])
                    _copy_block(kinds[slot], base, rows[slot], narrow, wide, x, y, z, quanta)


@njit(cache=True, nogil=True)
def _copy_block(
    kind: int, base: int, row: int, narrow: Any, wide: Any, x: int, y: int, z: int, quanta: Any
) -> None:
    """Copy a block whose first voxel has the position (x, y, z) in the window."""
    nx, ny, nz = quanta.shape
    for i in range(max(0, x), min(nx, x + BLOCK_SIDE)):
        for j in range(max(0, y), min(ny, y + BLOCK_SIDE)):
            for k in range(max(0, z), min(nz, z + BLOCK_SIDE)):
                local = local_index(i - x, j - y, k - z)
                known, value = quanta_of(kind, base, row, narrow, wide, local)
                if known:
                    quanta[i, j, k] = min(max(value, -32767), 32767)
