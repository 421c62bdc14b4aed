"""Compiled ways through a grid of free voxels."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numba import njit

_SAMPLES = 4  # per voxel along a straight line


@njit(cache=True, nogil=True)
def descend(lengths: Any, goal: Any, way: Any) -> int:
    """Follow the lengths of shortest ways from a voxel back to where they are 0.

    Args:
        lengths: of `space_kernels.path_lengths`, shape (nx, ny, nz).
        goal: position of the voxel, shape (3,); its length is finite.
        way: receives the positions from the goal to the start, shape (n, 3), n large enough.

    Returns:
        Number of positions.
    """
    nx, ny, nz = lengths.shape
    x, y, z = goal[0], goal[1], goal[2]
    count = 0
    while True:
        way[count, 0], way[count, 1], way[count, 2] = x, y, z
        count += 1
        best, bx, by, bz = lengths[x, y, z], x, y, z
        least = np.inf
        for a in range(max(0, x - 1), min(nx, x + 2)):
            for b in range(max(0, y - 1), min(ny, y + 2)):
                for c in range(max(0, z - 1), min(nz, z + 2)):
                    square = (a - x) * (a - x) + (b - y) * (b - y) + (c - z) * (c - z)
                    length = lengths[a, b, c] + math.sqrt(square)
                    if lengths[a, b, c] < best and length < least:
                        least, bx, by, bz = length, a, b, c
        if least == np.inf or count == len(way):
            return count
        x, y, z = bx, by, bz


@njit(cache=True, nogil=True)
def is_open_line(open_voxels: Any, start: Any, end: Any) -> bool:
    """Whether the straight line between two places, shape (3,) [voxels], stays in open voxels.

    Sampled four times per voxel: a corner that is cut by less is not seen.
    """
    nx, ny, nz = open_voxels.shape
    dx, dy, dz = end[0] - start[0], end[1] - start[1], end[2] - start[2]
    steps = int(math.sqrt(dx * dx + dy * dy + dz * dz) * _SAMPLES) + 1
    for i in range(steps + 1):
        share = i / steps
        x = math.floor(start[0] + share * dx)
        y = math.floor(start[1] + share * dy)
        z = math.floor(start[2] + share * dz)
        if x < 0 or y < 0 or z < 0 or x >= nx or y >= ny or z >= nz:
            return False
        if not open_voxels[x, y, z]:
            return False
    return True


@njit(cache=True, nogil=True)
def shorten(open_voxels: Any, way: Any, kept: Any) -> int:
    """Replace a way by straight lines: from each place on to the farthest one in a line.

    Args:
        open_voxels: shape (nx, ny, nz), bool.
        way: places [voxels], shape (n, 3).
        kept: receives the indices of the places that are left, shape (n,).

    Returns:
        Their number.
    """
    kept[0], count, here = 0, 1, 0
    while here < len(way) - 1:
        far = len(way) - 1
        while far > here + 1 and not is_open_line(open_voxels, way[here], way[far]):
            far -= 1
        here = far
        kept[count] = here
        count += 1
    return count
