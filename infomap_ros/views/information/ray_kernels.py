"""Compiled: what a ray is expected to tell.

A ray stands for the solid angle around it. What a view tells is an integral over the space it sees,

    I = sum over rays of  Omega  integral of  V(r) g(voxel at r, r) r^2 dr

in voxels, with V the probability that nothing before r hides it and g the bits of a voxel at that
distance. Volume, not voxels met, is counted: near voxels that many rays cross count once in all,
far ones that fall between rays are made up for by those that do not, and so the sum does not depend
on the number of rays but by sampling error.

Along a ray the integral is a sum over the middles of equal steps, at most a voxel long. ``gains``
holds g times the volume per steradian of each step, ``before`` its sum over the steps before, so
that a block whose voxels are all alike and hide nothing is crossed at once, to the same sum.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from infomap_ros.geometry.kernel import kernel
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.mapping.voxels.keys import BLOCK_BITS, BLOCK_SIDE
from infomap_ros.views.information.field import EMPTY, UNKNOWN

_FRACTION = 32
_BLOCK_SHIFT = _FRACTION + BLOCK_BITS
_DOUBT = 1e-5
_LEAST_DIRECTION = 1e-12


class RayArrays(NamedTuple):
    """What a ray looks up on its way.

    Attributes:
        directory: of a `VisibleField`.
        codes: of it.
        gains: bits per steradian by step and code, shape (steps, codes).
        before: sum of `gains` over the steps before, shape (steps + 1, codes).
        clear: probability by code that a step does not hide what is behind it.
        step: length of a step [voxels].
        least: below this probability nothing is seen any more.
    """

    directory: NDArray[np.int32]
    codes: NDArray[np.uint8]
    gains: NDArray[np.float32]
    before: NDArray[np.float32]
    clear: FloatArray
    step: float
    least: float


@kernel
def axis_steps(
    origin: float, direction: float, step: float, start: int
) -> tuple[Any, Any, int, float, float]:
    """One axis of a ray in fixed-point numbers.

    Args:
        origin: coordinate of the ray's origin [voxels].
        direction: component of its unit direction.
        step: length of a step [voxels].
        start: first step.

    Returns:
        Coordinate of the middle of the first step and its change by step, in units of
        ``2^-_FRACTION`` voxels; 1 if the ray leaves a block on its far side, else 0; and slope and
        shift by which the number of that side tells the step at which the ray leaves. A step that
        rounding could put on either side is not counted to the block.
    """
    unit = float(1 << _FRACTION)
    first = np.int64(math.floor((origin + direction * (start + 0.5) * step) * unit))
    away = max(abs(direction), _LEAST_DIRECTION) * step
    slope = (1.0 if direction > 0.0 else -1.0) / away
    change = np.int64(math.floor(direction * step * unit + 0.5))
    return first, change, int(direction > 0.0), BLOCK_SIDE * slope, 0.5 - _DOUBT - origin * slope


@kernel
def march(
    origin: Any, direction: Any, start: int, end: int, visible: float, arrays: Any
) -> tuple[float, float]:
    """Follow a ray over the steps [start, end).

    Args:
        origin: of the ray relative to the first block of the directory, tuple [voxels].
        direction: unit vector, tuple.
        start: first step.
        end: one past the last step.
        visible: probability that nothing before the first step hides it.
        arrays: a `RayArrays`.

    Returns:
        Bits per steradian, and probability that what follows is seen.
    """
    directory, codes, step = arrays.directory, arrays.codes, arrays.step
    gains, before, clear = arrays.gains, arrays.before, arrays.clear
    x, step_x, side_x, slope_x, shift_x = axis_steps(origin[0], direction[0], step, start)
    y, step_y, side_y, slope_y, shift_y = axis_steps(origin[1], direction[1], step, start)
    z, step_z, side_z, slope_z, shift_z = axis_steps(origin[2], direction[2], step, start)
    nx, ny, nz = directory.shape
    total, n = 0.0, start
    while n < end:
        i, j, k = x >> _BLOCK_SHIFT, y >> _BLOCK_SHIFT, z >> _BLOCK_SHIFT
        leave = min((i + side_x) * slope_x + shift_x, (j + side_y) * slope_y + shift_y)
        leave = min(leave, (k + side_z) * slope_z + shift_z)
        stop = min(max(int(min(leave, 1e9)), n + 1), end)
        entry = np.int64(-1 - UNKNOWN)
        if 0 <= i < nx and 0 <= j < ny and 0 <= k < nz:
            entry = np.int64(directory[i, j, k])
        code = -1 - entry
        if entry < 0 and clear[code] == 1.0:
            total += visible * (before[stop, code] - before[n, code])
            x, y, z = x + (stop - n) * step_x, y + (stop - n) * step_y, z + (stop - n) * step_z
            n = stop
            continue
        while n < stop:
            if entry >= 0:
                a, b, c = x >> _FRACTION & 7, y >> _FRACTION - 3 & 56, z >> _FRACTION - 6 & 448
                code = np.int64(codes[entry, a | b | c])
            x, y, z = x + step_x, y + step_y, z + step_z
            if code != EMPTY:
                total += visible * gains[n, code]
                visible *= clear[code]
                if visible < arrays.least:
                    return total, 0.0
            n += 1
    return total, visible


@kernel
def region_steps(
    origin: Any, direction: Any, low: Any, high: Any, step: float, steps: int
) -> tuple[int, int]:
    """Steps of a ray whose middles lie in the box from `low` to `high`, all in voxels."""
    near, far = 0.0, steps * step
    for axis in range(3):
        o, d = origin[axis], direction[axis]
        if abs(d) < _LEAST_DIRECTION:
            if not low[axis] <= o <= high[axis]:
                return 0, 0
            continue
        a, b = (low[axis] - o) / d, (high[axis] - o) / d
        near, far = max(near, min(a, b)), min(far, max(a, b))
    if near >= far:
        return 0, 0
    return int(near / step + 0.5), min(int(far / step + 0.5), steps)


@kernel
def ray_bits(origin: Any, direction: Any, low: Any, high: Any, arrays: Any) -> float:
    """What one ray tells about the box from `low` to `high` [bits/sr]; else as `march`."""
    start, end = region_steps(origin, direction, low, high, arrays.step, len(arrays.gains))
    visible = 1.0
    if start > 0:
        visible = march(origin, direction, 0, start, visible, arrays)[1]
    return march(origin, direction, start, end, visible, arrays)[0]


@kernel
def turned(rotation: Any, ray: Any) -> tuple[float, float, float]:
    """Rotation, shape (3, 3) or larger, times a vector, shape (3,)."""
    x, y, z = ray[0], ray[1], ray[2]
    return (
        rotation[0, 0] * x + rotation[0, 1] * y + rotation[0, 2] * z,
        rotation[1, 0] * x + rotation[1, 1] * y + rotation[1, 2] * z,
        rotation[2, 0] * x + rotation[2, 1] * y + rotation[2, 2] * z,
    )


@kernel
def view_bits(poses: Any, rays: Any, angles: Any, box: Any, arrays: Any, sums: Any) -> None:
    """Add to `sums`, shape (M,), what the rays tell from each pose [bits].

    Args:
        poses: T_map_camera, positions relative to the directory [voxels], shape (M, 4, 4).
        rays: unit directions in the camera frame, shape (N, 3).
        angles: solid angle of each ray, shape (N,) [sr].
        box: the region that counts, (low, high) corners relative to the directory [voxels].
        arrays: a `RayArrays`.
        sums: see above.
    """
    low, high = (box[0, 0], box[0, 1], box[0, 2]), (box[1, 0], box[1, 1], box[1, 2])
    for view in range(len(poses)):
        pose = poses[view]
        origin = (pose[0, 3], pose[1, 3], pose[2, 3])
        for ray in range(len(rays)):
            direction = turned(pose, rays[ray])
            sums[view] += angles[ray] * ray_bits(origin, direction, low, high, arrays)
