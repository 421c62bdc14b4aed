"""Compiled work on the rows of map updates; their layout in `infomap_ros.team.wire`."""

from __future__ import annotations

from typing import Any

import numpy as np

from infomap_ros.geometry.kernel import kernel

TILE_SHIFT, RUN_SHIFT = 8, 3
"""A message spans 2^8 voxels along each axis at the most, a run holds 2^3 neighbors along x."""

ORDER_SHIFT = 3 * TILE_SHIFT
"""Numbers of `order_of_blocks` shifted by this are those of the parts that fit a message."""

NOT_TOLD = -127
"""Log-odds of a voxel of which a row says nothing."""

_TILES = 13  # [bits] of the number of tiles along an axis


@kernel
def lowest_corner(indices: Any, rows: Any, corner: Any) -> None:
    """Smallest coordinates, shape (3,), of the voxels that `rows` chooses of `indices`."""
    for axis in range(3):
        corner[axis] = indices[rows[0], axis]
    for row in rows:
        for axis in range(3):
            corner[axis] = min(corner[axis], np.int64(indices[row, axis]))


@kernel
def order_of_blocks(indices: Any, rows: Any, origin: Any, keys: Any) -> None:
    """Numbers that grow along the parts, in them along the blocks, and in these along the runs.

    Args:
        indices: of voxels, shape (K, 3).
        rows: of `indices`, shape (n,).
        origin: shape (3,), no larger than any of these.
        keys: receives the numbers, shape (n,), int64.
    """
    for i in range(len(rows)):
        tile, block, place = np.int64(0), np.int64(0), np.int64(0)
        for axis in (2, 1, 0):
            value = np.int64(indices[rows[i], axis]) - origin[axis]
            tile = (tile << _TILES) | (value >> TILE_SHIFT)
            block = (block << (TILE_SHIFT - RUN_SHIFT)) | ((value >> RUN_SHIFT) & 31)
            place = (place << RUN_SHIFT) | (value & 7)
        keys[i] = (tile << ORDER_SHIFT) | (block << (3 * RUN_SHIFT)) | place


@kernel
def fill_runs(
    indices: Any, versions: Any, log_odds: Any, rows: Any, origin: Any, filled: Any
) -> int:
    """Put the evidence of voxels into runs.

    Args:
        indices: of voxels, shape (K, 3).
        versions: of their states, shape (K,).
        log_odds: likewise.
        rows: of these, shape (n,), so ordered that the voxels of a run follow each other.
        origin: of the message, a multiple of a run's length, shape (3,).
        filled: receive, with room for n runs, the index of the first voxel, uint8, shape (n, 3);
            the log-odds, int8, shape (n, 8); and the row of the first voxel that is told, int64.

    Returns:
        Number of runs.
    """
    index, odds, first = filled
    used, last = 0, np.int64(-1)
    for row in rows:
        x = np.int64(indices[row, 0]) - origin[0]
        y = np.int64(indices[row, 1]) - origin[1]
        z = np.int64(indices[row, 2]) - origin[2]
        start = (((z << TILE_SHIFT) | y) << TILE_SHIFT) | (x & ~np.int64(7))
        if start != last or versions[row] != versions[first[used - 1]]:
            index[used, 0], index[used, 1], index[used, 2] = x & ~np.int64(7), y, z
            for i in range(8):
                odds[used, i] = NOT_TOLD
            first[used] = row
            used, last = used + 1, start
        odds[used - 1, x & 7] = log_odds[row]
    return used
