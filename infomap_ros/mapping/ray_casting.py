"""Where rays meet the map: its surface, or the faces of its occupied voxels.

The box of an occupied voxel begins up to a voxel's diagonal before the surface in it, and rays
that pass beside a surface meet the boxes of its voxels all the same. The surface is where the
Gaussians are. That of a voxel stands for a patch of a plane: through its mean, across its smallest
axis. Where noise was too large for a normal (`FLAT`) it is a plane that faces the ray.

A patch reaches to the faces of its voxel and a little beyond where the surface goes on in a voxel
behind the face. At the edge of an object it fills a part of the voxel, and its mean is in the
middle of that part: there it reaches as far to one side of its mean as the nearer face of the voxel
is on the other, and `_MARGIN` farther with less and less chance, as means are noisy.

A ray is stopped by a patch with the probability that its voxel is occupied times that chance, and
goes on with the rest. Where it is stopped more likely than not, the distance is the mean over the
patches about that place, weighted by how likely the ray ends in them.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from infomap_ros.geometry.kernel import kernel
from infomap_ros.geometry.symmetric import smallest_axis
from infomap_ros.mapping.config import LOG_ODDS_QUANTUM
from infomap_ros.mapping.voxels.block_kernels import find_block, quanta_at
from infomap_ros.mapping.voxels.keys import (
    BLOCK_BITS,
    begin_walk,
    exit_distance,
    local_index,
    next_voxel,
    pack,
)
from infomap_ros.mapping.voxels.surface_kernels import (
    ROW_SIZE,
    lies_in_voxel,
    read_information,
    variance_along,
)

FLAT = 0.9
"""A Gaussian has a normal where the variance along it is less than this share of that across it."""

_GRAZING = 0.02
"""Cosine of incidence below which a ray passes a plane: on its way through a voxel it would come
nearer to it by no more than this share of a voxel."""

_MARGIN = 0.25
"""How far beyond an edge of its patch a plane may still stop a ray [voxels]."""

_SPARE = 0.2
"""How far beyond its voxel a plane may still stop a ray where the surface goes on [voxels]."""

_STEP = 0.2
"""A mean so near to a plane continues its surface [voxels]."""

_TOGETHER = 1.5
"""Patches within this distance along a ray are of one surface [voxels]."""

_STOPPED = 0.5
"""A ray ends where it has been stopped with this probability."""


def scratch() -> tuple[Any, Any]:
    """What `cast_to_surface` works with: two rows and two vectors."""
    return np.empty((2, ROW_SIZE), np.float32), np.empty((2, 6))


@kernel
def cast_to_surface(
    blocks: Any,
    gaussians: Any,
    origins: Any,
    directions: Any,
    max_range: float,
    size: float,
    rows: Any,
    vectors: Any,
    distances: Any,
    sigmas: Any,
) -> None:
    """Distance along each ray to the surface, and its standard deviation; NaN where none is met.

    Args:
        blocks: a `BlockArrays`.
        gaussians: a `SurfaceArrays`.
        origins: shape (n, 3) [m].
        directions: unit vectors, shape (n, 3).
        max_range: [m].
        size: of a voxel [m].
        rows: to work with, see `scratch`.
        vectors: to work with, likewise.
        distances: receives distances, shape (n,) [m].
        sigmas: receives standard deviations, shape (n,) [m].
    """
    for ray in range(len(origins)):
        origin = (origins[ray, 0], origins[ray, 1], origins[ray, 2])
        direction = (directions[ray, 0], directions[ray, 1], directions[ray, 2])
        distances[ray], sigmas[ray] = _cast(
            blocks, gaussians, origin, direction, max_range, size, rows, vectors
        )


@kernel
def _cast(
    blocks: Any,
    gaussians: Any,
    origin: Any,
    direction: Any,
    max_range: float,
    size: float,
    rows: Any,
    vectors: Any,
) -> tuple[float, float]:
    """`cast_to_surface` of one ray; origin and direction are tuples."""
    voxel, crossings, steps, deltas = begin_walk(
        origin[0] / size,
        origin[1] / size,
        origin[2] / size,
        direction[0] / size,
        direction[1] / size,
        direction[2] / size,
    )
    block_key, slot, entered = np.int64(-1), np.int64(-1), 0.0
    passed, ended, first, second, spread = 1.0, 0.0, 0.0, 0.0, 0.0  # of the surface at hand
    while entered < max_range:
        if ended > 0.0 and entered > first / ended + _TOGETHER * size:
            if passed - ended <= _STOPPED:
                break
            passed, ended, first, second, spread = passed - ended, 0.0, 0.0, 0.0, 0.0
        i, j, k = voxel
        key = pack(i >> BLOCK_BITS, j >> BLOCK_BITS, k >> BLOCK_BITS)
        if key != block_key:
            block_key, slot = key, np.int64(find_block(blocks, key))
        leave = exit_distance(crossings)
        if slot >= 0:
            quanta = quanta_at(blocks, slot, local_index(i, j, k))[1]
            if quanta > 0:
                chance, distance, variance = _meet(
                    blocks, gaussians, slot, voxel, origin, direction, entered, size, rows, vectors
                )
                weight = chance * (passed - ended) / (1.0 + math.exp(-LOG_ODDS_QUANTUM * quanta))
                is_behind = ended > 0.0 and distance > first / ended + _TOGETHER * size
                if is_behind and passed - ended <= _STOPPED:
                    break
                if is_behind and weight > 0.0:
                    passed, ended, first, second, spread = passed - ended, 0.0, 0.0, 0.0, 0.0
                if distance <= max_range:
                    ended += weight
                    first += weight * distance
                    second += weight * distance * distance
                    spread += weight * variance
        entered = leave
        voxel, crossings = next_voxel(voxel, crossings, steps, deltas)
    if not (ended > 0.0 and passed - ended <= _STOPPED):
        return math.nan, math.nan
    mean = first / ended
    return mean, math.sqrt((spread + max(second - mean * first, 0.0)) / ended)


@kernel
def _meet(
    blocks: Any,
    gaussians: Any,
    slot: int,
    voxel: Any,
    origin: Any,
    direction: Any,
    entered: float,
    size: float,
    rows: Any,
    vectors: Any,
) -> tuple[float, float, float]:
    """How a ray meets what is in an occupied voxel.

    Returns:
        The chance that it meets it, at which distance [m], and the variance of that [m^2].
    """
    i, j, k = voxel
    half = 0.5 * size
    covariance, mean = vectors[0], vectors[1]
    is_one = read_information(gaussians, slot, local_index(i, j, k), half, rows[0], rows[1])
    if not (is_one and lies_in_voxel(rows[0], half, covariance, mean)):
        if is_one or _is_beside_surface(blocks, gaussians, voxel, half, rows, vectors):
            return 0.0, 0.0, 0.0  # the surface is elsewhere
        return 1.0, entered, size * size / 12.0
    dx, dy, dz = direction
    x, y, z = (
        (i + 0.5) * size + mean[0] - origin[0],
        (j + 0.5) * size + mean[1] - origin[1],
        (k + 0.5) * size + mean[2] - origin[2],
    )
    distance, variance, normal = _distance_to_plane(covariance, (x, y, z), direction)
    if not distance > 0.0:
        return 0.0, distance, variance
    offset = (distance * dx - x, distance * dy - y, distance * dz - z)
    place = (mean[0], mean[1], mean[2])
    chance = _chance(blocks, gaussians, voxel, offset, place, normal, half, rows, vectors)
    return chance, distance, variance


@kernel
def _distance_to_plane(covariance: Any, mean: Any, direction: Any) -> tuple[float, float, Any]:
    """Where a ray crosses the plane of a Gaussian, the variance of that, and the plane's normal.

    The distance is negative where the ray passes it.

    Args:
        covariance: (xx, xy, xz, yy, yz, zz) [m^2].
        mean: relative to where the ray begins [m].
        direction: unit vector.
    """
    c, (x, y, z), (dx, dy, dz) = covariance, mean, direction
    variance, nx, ny, nz = smallest_axis(c[0], c[1], c[2], c[3], c[4], c[5])
    across = 0.5 * (c[0] + c[3] + c[5] - variance)
    incidence = dx * nx + dy * ny + dz * nz
    if variance < FLAT * across:  # not where it is NaN
        if abs(incidence) < _GRAZING:
            return -1.0, variance, (nx, ny, nz)
        distance = (x * nx + y * ny + z * nz) / incidence
        return distance, variance / (incidence * incidence), (nx, ny, nz)
    return x * dx + y * dy + z * dz, variance_along(c, dx, dy, dz), direction


@kernel
def _chance(
    blocks: Any,
    gaussians: Any,
    voxel: Any,
    offset: Any,
    mean: Any,
    normal: Any,
    half: float,
    rows: Any,
    vectors: Any,
) -> float:
    """The chance that a place in the plane of a voxel is part of its patch.

    Args:
        blocks: see `cast_to_surface`, likewise gaussians, rows and vectors.
        gaussians: see blocks.
        voxel: the voxel.
        offset: of the place from the patch's mean [m].
        mean: relative to the voxel's center [m].
        normal: of the plane.
        half: half a voxel [m].
        rows: see blocks.
        vectors: see blocks.
    """
    out, outside, axis = 0.0, 0.0, 0
    for n in range(3):
        beyond = abs(offset[n]) - max(half - abs(mean[n]), 0.0)
        if beyond > out:
            out, axis = beyond, n
        outside = max(outside, abs(offset[n] + mean[n]) - half)
    if out == 0.0:
        return 1.0
    if outside < 2.0 * _SPARE * half:
        towards = 1 if offset[axis] > 0.0 else -1
        if _goes_on(blocks, gaussians, voxel, axis, towards, mean, normal, half, rows, vectors):
            return 1.0
    return max(1.0 - out / (2.0 * _MARGIN * half), 0.0)


@kernel
def _goes_on(
    blocks: Any,
    gaussians: Any,
    voxel: Any,
    axis: int,
    towards: int,
    mean: Any,
    normal: Any,
    half: float,
    rows: Any,
    vectors: Any,
) -> bool:
    """Whether one of the nine voxels beyond a face continues the surface of a voxel."""
    for n in range(9):
        a, b = (n + 1) % 3 - 1, (n // 3 + 1) % 3 - 1
        if axis == 0:
            i, j, k = towards, a, b
        elif axis == 1:
            i, j, k = a, towards, b
        else:
            i, j, k = a, b, towards
        other = (voxel[0] + i, voxel[1] + j, voxel[2] + k)
        if _has_surface(blocks, gaussians, other, half, rows, vectors):
            found = vectors[1]
            apart = (2.0 * half * i + found[0] - mean[0]) * normal[0]
            apart += (2.0 * half * j + found[1] - mean[1]) * normal[1]
            apart += (2.0 * half * k + found[2] - mean[2]) * normal[2]
            if abs(apart) < 2.0 * _STEP * half:
                return True
    return False


@kernel
def _has_surface(
    blocks: Any, gaussians: Any, voxel: Any, half: float, rows: Any, vectors: Any
) -> bool:
    """Whether a voxel is occupied and its Gaussian, which `vectors` receive, lies in it."""
    i, j, k = voxel
    slot = np.int64(find_block(blocks, pack(i >> BLOCK_BITS, j >> BLOCK_BITS, k >> BLOCK_BITS)))
    local = local_index(i, j, k)
    if slot < 0 or quanta_at(blocks, slot, local)[1] <= 0:
        return False
    is_one = read_information(gaussians, slot, local, half, rows[0], rows[1])
    return bool(is_one and lies_in_voxel(rows[0], half, vectors[0], vectors[1]))


@kernel
def _is_beside_surface(
    blocks: Any, gaussians: Any, voxel: Any, half: float, rows: Any, vectors: Any
) -> bool:
    """Whether one of the 26 voxels around is occupied and has a surface in it.

    Then the surface lies there, and noise alone made this one occupied.
    """
    for n in range(27):
        other = (voxel[0] + n % 3 - 1, voxel[1] + (n // 3) % 3 - 1, voxel[2] + n // 9 - 1)
        if n != 13 and _has_surface(blocks, gaussians, other, half, rows, vectors):
            return True
    return False


@kernel
def cast_to_voxels(
    blocks: Any,
    origins: Any,
    directions: Any,
    max_range: float,
    inverse_size: float,
    distances: Any,
    hits: Any,
) -> None:
    """Distance along each ray to the first occupied voxel; see `VoxelMap.first_occupied`."""
    for ray in range(len(origins)):
        x, y, z = (
            origins[ray, 0] * inverse_size,
            origins[ray, 1] * inverse_size,
            origins[ray, 2] * inverse_size,
        )
        dx, dy, dz = (
            directions[ray, 0] * inverse_size,
            directions[ray, 1] * inverse_size,
            directions[ray, 2] * inverse_size,
        )
        voxel, crossings, steps, deltas = begin_walk(x, y, z, dx, dy, dz)
        block_key, slot, entered = np.int64(-1), np.int64(-1), 0.0
        distances[ray], hits[ray] = max_range, False
        while entered < max_range:
            i, j, k = voxel
            key = pack(i >> BLOCK_BITS, j >> BLOCK_BITS, k >> BLOCK_BITS)
            if key != block_key:
                block_key, slot = key, np.int64(find_block(blocks, key))
            if slot >= 0 and quanta_at(blocks, slot, local_index(i, j, k))[1] > 0:
                distances[ray], hits[ray] = entered, True
                break
            entered = exit_distance(crossings)
            voxel, crossings = next_voxel(voxel, crossings, steps, deltas)
