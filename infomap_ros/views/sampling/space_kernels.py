"""Compiled questions to a dense window: where is room, what is connected, how far is it."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit

from infomap_ros.mapping import FREE, OCCUPIED, UNCERTAIN, UNKNOWN

_FAR = np.int32(1 << 14)


@njit(cache=True, nogil=True)
def _near_along_z(free: Any, reach: int, out: Any) -> None:
    """Squared distance along z to the nearest voxel that is not free, in voxels."""
    nx, ny, nz = free.shape
    for x in range(nx):
        for y in range(ny):
            run = reach + 1
            for z in range(nz):
                run = run + 1 if free[x, y, z] else 0
                out[x, y, z] = min(run, reach + 1)
            run = reach + 1
            for z in range(nz - 1, -1, -1):
                run = run + 1 if free[x, y, z] else 0
                near = min(np.int64(out[x, y, z]), np.int64(run))
                out[x, y, z] = _FAR if near > reach else near * near


@njit(cache=True, nogil=True)
def _near_along_y(reach: int, near: Any, line: Any) -> None:
    nx, ny, nz = near.shape
    for x in range(nx):
        line[:, :] = near[x]
        for y in range(ny):
            for other in range(max(0, y - reach), min(ny, y + reach + 1)):
                step = np.int32((other - y) * (other - y))
                for z in range(nz):
                    near[x, y, z] = min(near[x, y, z], line[other, z] + step)


@njit(cache=True, nogil=True)
def free_balls(free: Any, reach: int, limit: float, near: Any, out: Any) -> None:
    """Voxels around which a whole ball is free.

    The exact Euclidean distance transform, axis by axis, cut off beyond the ball.

    Args:
        free: shape (nx, ny, nz), bool.
        reach: radius of the ball in voxels, rounded up.
        limit: squared radius in voxels; a voxel that is not free must be farther.
        near: scratch, int32, shape of `free`.
        out: shape (nx - 2 reach, ny - 2 reach, nz - 2 reach), bool, without the margin.
    """
    nx, ny, nz = out.shape
    _near_along_z(free, reach, near)
    _near_along_y(reach, near, np.empty(near.shape[1:], np.int32))
    for x in range(nx):
        for y in range(ny):
            for z in range(nz):
                smallest = _FAR
                for step in range(-reach, reach + 1):
                    along = near[x + reach + step, y + reach, z + reach]
                    smallest = min(smallest, along + np.int32(step * step))
                out[x, y, z] = smallest > limit


@njit(cache=True, nogil=True)
def path_lengths(open_cells: Any, start: Any, lengths: Any, queue: Any, queued: Any) -> None:
    """Length of the shortest path over the 26 neighbors from `start` to every cell, in cells.

    Args:
        open_cells: shape (nx, ny, nz), bool.
        start: position of the first cell, shape (3,); need not be open.
        lengths: float32, filled with inf; receives the answer.
        queue: scratch, int64, of the size of `open_cells`.
        queued: scratch, bool, False, of the shape of `open_cells`.
    """
    nx, ny, nz = open_cells.shape
    lengths[start[0], start[1], start[2]] = 0.0
    queue[0] = (start[0] * ny + start[1]) * nz + start[2]
    head, tail, count = 0, 1 % len(queue), 1
    while count > 0:
        place = queue[head]
        head, count = (head + 1) % len(queue), count - 1
        z, y, x = place % nz, (place // nz) % ny, place // (nz * ny)
        queued[x, y, z] = False
        for a in range(max(0, x - 1), min(nx, x + 2)):
            for b in range(max(0, y - 1), min(ny, y + 2)):
                for c in range(max(0, z - 1), min(nz, z + 2)):
                    if not open_cells[a, b, c]:
                        continue
                    square = (a - x) * (a - x) + (b - y) * (b - y) + (c - z) * (c - z)
                    length = lengths[x, y, z] + np.float32(np.sqrt(square))
                    if length < lengths[a, b, c] - np.float32(1e-4):
                        lengths[a, b, c] = length
                        if not queued[a, b, c]:
                            queued[a, b, c] = True
                            queue[tail] = (a * ny + b) * nz + c
                            tail, count = (tail + 1) % len(queue), count + 1


@njit(cache=True, nogil=True)
def count_targets(states: Any, edge: int, low: Any, high: Any, counts: Any, sums: Any) -> None:
    """Count what is worth looking at in cells of ``edge^3`` voxels.

    That is voxels on the periphery of the known (free, with an unknown neighbor) and uncertain
    ones, within the positions from `low` to `high`; obstacles are counted apart. What is unknown
    beyond these positions makes no periphery.

    Args:
        states: shape (nx, ny, nz), as `VoxelWindow.states`.
        edge: of a cell in voxels.
        low: first position that counts, shape (3,).
        high: position behind the last that counts, shape (3,).
        counts: int32 (cx, cy, cz, 2), zero: targets and obstacles.
        sums: float64 (cx, cy, cz, 3), zero: sum of the targets' positions.
    """
    nx, ny, nz = states.shape
    for x in range(max(0, low[0]), min(nx, high[0])):
        for y in range(max(0, low[1]), min(ny, high[1])):
            for z in range(max(0, low[2]), min(nz, high[2])):
                state = states[x, y, z]
                if state == UNKNOWN:
                    continue
                cell = (x // edge, y // edge, z // edge)
                if state == OCCUPIED:
                    counts[cell[0], cell[1], cell[2], 1] += 1
                elif state == UNCERTAIN or _is_periphery(states, x, y, z, low, high):
                    counts[cell[0], cell[1], cell[2], 0] += 1
                    sums[cell[0], cell[1], cell[2], 0] += x
                    sums[cell[0], cell[1], cell[2], 1] += y
                    sums[cell[0], cell[1], cell[2], 2] += z


@njit(cache=True, nogil=True)
def _is_periphery(states: Any, x: int, y: int, z: int, low: Any, high: Any) -> bool:
    """A free voxel with an unknown neighbor that counts; the outermost layer is not judged."""
    nx, ny, nz = states.shape
    if states[x, y, z] != FREE:
        return False
    if x == 0 or y == 0 or z == 0 or x == nx - 1 or y == ny - 1 or z == nz - 1:
        return False
    return bool(
        (x > low[0] and states[x - 1, y, z] == UNKNOWN)
        or (x + 1 < high[0] and states[x + 1, y, z] == UNKNOWN)
        or (y > low[1] and states[x, y - 1, z] == UNKNOWN)
        or (y + 1 < high[1] and states[x, y + 1, z] == UNKNOWN)
        or (z > low[2] and states[x, y, z - 1] == UNKNOWN)
        or (z + 1 < high[2] and states[x, y, z + 1] == UNKNOWN)
    )
