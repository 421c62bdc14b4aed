"""Compiled: what one ray is expected to tell.

A ray stands for the solid angle around it. What a view tells is an integral over the space it sees,

    I = sum over rays of  Omega  sum over voxels of  V g(code, r) (r_out^3 - r_in^3) / 3

in voxels, with V the probability that nothing before the voxel hides it and g the bits of the voxel
at distance r. Volume, not voxels met, is counted: near voxels that many rays cross count once in
all, far ones that fall between rays are made up for by those that do not, and so the sum does not
depend on the number of rays but by sampling error.

Lengths are in voxels throughout. Blocks whose voxels are all alike and hide nothing are crossed in
one step: the integral of g r^2 for their code is ``offsets + table r^3 / 3`` in each interval of r.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numba import njit

from infomap_ros.mapping.keys import BLOCK_SIDE
from infomap_ros.mapping.scan import axis_start
from infomap_ros.views.field import EMPTY, UNKNOWN

_THIRD = 1.0 / 3.0


@njit(cache=True, nogil=True)
def voxel_axis(origin: float, direction: float, entered: float, block: int) -> tuple[int, float]:
    """Voxel in which a ray enters a block, within the block, and distance where it leaves it."""
    start = block * BLOCK_SIDE
    local = math.floor(origin + direction * entered) - start
    local = min(max(local, 0), BLOCK_SIDE - 1)
    if direction > 0.0:
        return local, (start + local + 1 - origin) / direction
    if direction < 0.0:
        return local, (start + local - origin) / direction
    return local, np.inf


@njit(cache=True, nogil=True)
def integral(table: Any, offsets: Any, code: int, per_voxel: float, a: float, b: float) -> float:
    """Integral of g r^2 from a to b for one code."""
    i, j = min(int(a * per_voxel), len(table) - 1), min(int(b * per_voxel), len(table) - 1)
    low = offsets[i, code] + table[i, code] * a * a * a * _THIRD
    high = offsets[j, code] + table[j, code] * b * b * b * _THIRD
    return high - low


@njit(cache=True, nogil=True)
def cross_block(
    origin: Any,
    direction: Any,
    block: Any,
    entered: float,
    left: float,
    near: float,
    far: float,
    visible: float,
    codes: Any,
    table: Any,
    clear: Any,
    per_voxel: float,
    density: float,
    least: float,
) -> tuple[float, float]:
    """Follow a ray voxel by voxel through one block.

    Args:
        origin: of the ray, tuple [voxels].
        direction: unit vector, tuple.
        block: block coordinates, tuple.
        entered: distance at which the ray enters the block.
        left: distance at which it leaves it.
        near: nothing nearer counts.
        far: nothing farther counts.
        visible: probability that the block is seen.
        codes: of the block's voxels, shape (512,).
        table: bits by distance and code.
        clear: probability by code that a voxel does not hide what is behind it.
        per_voxel: rows of `table` per voxel of distance.
        density: of what hides things in unknown space [1/voxel].
        least: below this probability nothing is seen any more.

    Returns:
        Bits, and probability that what follows is seen.
    """
    dx, dy, dz = direction
    i, next_x = voxel_axis(origin[0], dx, entered, block[0])
    j, next_y = voxel_axis(origin[1], dy, entered, block[1])
    k, next_z = voxel_axis(origin[2], dz, entered, block[2])
    step_x, step_y, step_z = (1 if dx > 0.0 else -1), (1 if dy > 0.0 else -1), 1 if dz > 0.0 else -1
    delta_x = abs(1.0 / dx) if dx != 0.0 else np.inf
    delta_y = abs(1.0 / dy) if dy != 0.0 else np.inf
    delta_z = abs(1.0 / dz) if dz != 0.0 else np.inf
    total, end, last = 0.0, min(left, far), len(table) - 1
    while True:
        leave = min(next_x, min(next_y, next_z))
        code = codes[i | (j << 3) | (k << 6)]
        if code != EMPTY:
            a, b = max(entered, near), min(leave, end)
            if b > a:
                row = min(int(0.5 * (a + b) * per_voxel), last)
                total += visible * table[row, code] * (b * b * b - a * a * a) * _THIRD
            visible *= clear[code]
            if code == UNKNOWN and density > 0.0:
                visible *= math.exp(-density * max(leave - entered, 0.0))
            if visible < least:
                return total, 0.0
        if leave >= end:
            return total, visible
        entered = leave
        if next_x == leave:
            i += step_x
            next_x += delta_x
        elif next_y == leave:
            j += step_y
            next_y += delta_y
        else:
            k += step_z
            next_z += delta_z
        if (i | j | k) & ~(BLOCK_SIDE - 1):
            return total, visible


@njit(cache=True, nogil=True)
def ray_bits(
    origin: Any,
    direction: Any,
    near: float,
    far: float,
    directory: Any,
    first: Any,
    codes: Any,
    table: Any,
    offsets: Any,
    clear: Any,
    per_voxel: float,
    density: float,
    least: float,
) -> float:
    """What one ray is expected to tell, per steradian [bits/sr].

    Args:
        origin: of the ray, tuple [voxels].
        direction: unit vector, tuple.
        near: nothing nearer counts.
        far: nothing farther counts.
        directory: of a `VisibleField`.
        first: of it, tuple.
        codes: of it.
        table: bits of a voxel by distance and code, shape (rows, CODE_COUNT).
        offsets: so that ``offsets + table r^3 / 3`` is the integral of g r^2 from 0.
        clear: probability by code that a voxel does not hide what is behind it.
        per_voxel: rows of `table` per voxel of distance.
        density: of what hides things in unknown space [1/voxel].
        least: below this probability nothing is seen any more.
    """
    dx, dy, dz = direction
    scale = 1.0 / BLOCK_SIDE
    x, y, z = origin[0] * scale, origin[1] * scale, origin[2] * scale
    bx, by, bz = math.floor(x), math.floor(y), math.floor(z)
    step_x, next_x, delta_x = axis_start(x, dx * scale, bx)
    step_y, next_y, delta_y = axis_start(y, dy * scale, by)
    step_z, next_z, delta_z = axis_start(z, dz * scale, bz)
    x0, y0, z0 = first
    nx, ny, nz = directory.shape
    entered, total, visible = 0.0, 0.0, 1.0
    while True:
        leave = min(next_x, min(next_y, next_z))
        i, j, k = bx - x0, by - y0, bz - z0
        entry = -1 - UNKNOWN
        if 0 <= i < nx and 0 <= j < ny and 0 <= k < nz:
            entry = directory[i, j, k]
        if entry >= 0:
            bits, visible = cross_block(
                origin, direction, (bx, by, bz), entered, leave, near, far, visible,
                codes[entry], table, clear, per_voxel, density, least,
            )  # fmt: skip
            total += bits
        elif entry < -1:
            a, b = max(entered, near), min(leave, far)
            bits = integral(table, offsets, -1 - entry, per_voxel, a, b) if b > a else 0.0
            if entry == -1 - UNKNOWN and density > 0.0:
                depth = max(density * (leave - entered), 1e-9)
                through = math.exp(-depth)
                total += visible * bits * (1.0 - through) / depth
                visible *= through
            else:
                total += visible * bits
        if visible < least or leave >= far:
            return total
        entered = leave
        if next_x == leave:
            bx += step_x
            next_x += delta_x
        elif next_y == leave:
            by += step_y
            next_y += delta_y
        else:
            bz += step_z
            next_z += delta_z


@njit(cache=True, nogil=True)
def region_limits(
    origin: Any, direction: Any, low: Any, high: Any, near: float, far: float
) -> tuple[float, float]:
    """Part of [near, far] in which a ray runs through the box from `low` to `high`."""
    for axis in range(3):
        o, d = origin[axis], direction[axis]
        if d == 0.0:
            if not low[axis] <= o <= high[axis]:
                return far, near
            continue
        a, b = (low[axis] - o) / d, (high[axis] - o) / d
        near, far = max(near, min(a, b)), min(far, max(a, b))
    return near, far


@njit(cache=True, nogil=True)
def view_bits(
    poses: Any,
    rays: Any,
    angles: Any,
    limits: Any,
    box: Any,
    directory: Any,
    first: Any,
    codes: Any,
    table: Any,
    offsets: Any,
    clear: Any,
    numbers: Any,
    sums: Any,
) -> None:
    """Add to `sums`, shape (M,), what the rays tell from each pose [bits].

    Args:
        poses: T_map_camera with positions in voxels, shape (M, 4, 4).
        rays: unit directions in the camera frame, shape (N, 3).
        angles: solid angle of each ray, shape (N,) [sr].
        limits: nearest and farthest distance that counts [voxels].
        box: the region that counts, (low, high) corners [voxels].
        directory: see `ray_bits`, also for the next five.
        first: see `ray_bits`.
        codes: see `ray_bits`.
        table: see `ray_bits`.
        offsets: see `ray_bits`.
        clear: see `ray_bits`.
        numbers: per_voxel, density and least of `ray_bits`.
        sums: see above.
    """
    corner, (per_voxel, density, least) = (first[0], first[1], first[2]), numbers
    low, high = (box[0, 0], box[0, 1], box[0, 2]), (box[1, 0], box[1, 1], box[1, 2])
    for view in range(len(poses)):
        pose = poses[view]
        origin = (pose[0, 3], pose[1, 3], pose[2, 3])
        for ray in range(len(rays)):
            x, y, z = rays[ray, 0], rays[ray, 1], rays[ray, 2]
            direction = (
                pose[0, 0] * x + pose[0, 1] * y + pose[0, 2] * z,
                pose[1, 0] * x + pose[1, 1] * y + pose[1, 2] * z,
                pose[2, 0] * x + pose[2, 1] * y + pose[2, 2] * z,
            )
            near, far = region_limits(origin, direction, low, high, limits[0], limits[1])
            if near < far:
                sums[view] += angles[ray] * ray_bits(
                    origin, direction, near, far, directory, corner, codes, table, offsets,
                    clear, per_voxel, density, least,
                )  # fmt: skip
