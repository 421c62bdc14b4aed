"""Packed voxel and block coordinates, and their hashing.

Three 21-bit coordinates share one int64. A block is a cube of 8 x 8 x 8 voxels; the local index
of a voxel in its block is ``x + 8 y + 64 z``.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from infomap_ros.geometry.kernel import kernel

KEY_X, KEY_Y = 42, 21
"""Bits by which x and y are shifted in a key."""

BLOCK_BITS = 3
BLOCK_SIDE = 1 << BLOCK_BITS
BLOCK_VOXELS = BLOCK_SIDE**3
COORDINATE_LIMIT = 1 << 20
"""Voxel indices lie in [-COORDINATE_LIMIT, COORDINATE_LIMIT)."""

_MASK = (1 << 21) - 1
_MULTIPLIER = np.uint64(0x9E3779B97F4A7C15)


@kernel
def pack(x: int, y: int, z: int) -> Any:
    """Pack three coordinates within the limit into one key."""
    limit = COORDINATE_LIMIT
    high = ((np.int64(x) + limit) << KEY_X) | ((np.int64(y) + limit) << KEY_Y)
    return high | (np.int64(z) + limit)


def pack_all(coordinates: NDArray[np.int64]) -> NDArray[np.int64]:
    """`pack` of many: shape (N, 3) -> (N,)."""
    x, y, z = (coordinates + COORDINATE_LIMIT).T
    return np.asarray((x << 42) | (y << 21) | z)


def unpack_all(keys: NDArray[np.int64]) -> NDArray[np.int64]:
    """Inverse of `pack_all`: shape (N,) -> (N, 3)."""
    return np.column_stack([keys >> 42, (keys >> 21) & _MASK, keys & _MASK]) - COORDINATE_LIMIT


@kernel
def unpack(key: int) -> tuple[int, int, int]:
    """Inverse of `pack`."""
    limit = COORDINATE_LIMIT
    return (key >> 42) - limit, ((key >> 21) & _MASK) - limit, (key & _MASK) - limit


@kernel
def table_slot(key: int, size: int) -> Any:
    """First slot of `key` in an open-addressing table of any `size` (multiply-shift)."""
    mixed = (np.uint64(key) * _MULTIPLIER) >> np.uint64(32)
    return np.int64((mixed * np.uint64(size)) >> np.uint64(32))


@kernel
def rehash(table: Any, keys: Any, count: int) -> None:
    """Enter the first `count` keys into an empty table."""
    for slot in range(count):
        place = table_slot(keys[slot], len(table))
        while table[place] >= 0:
            place += 1
            if place == len(table):
                place = 0
        table[place] = slot


@kernel
def local_index(x: int, y: int, z: int) -> int:
    """Index of a voxel within its block, from its voxel coordinates."""
    return (x & 7) | ((y & 7) << 3) | ((z & 7) << 6)
