"""Compiled: what rays cross, voxel by voxel up to the first surface."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit

from infomap_ros.mapping.scans.grid_walk import begin_walk, next_voxel, way_through
from infomap_ros.views.information.field import code_at
from infomap_ros.views.information.ray_kernels import turned

OCCLUSION_AWARE, UNOBSERVED, REAR_SIDE, REAR_SIDE_ENTROPY, PROXIMITY = range(5)
SURFACE_RAY_ENTROPY, SURFACE_RAY_VOXELS, FIRST_SURFACE, FIRST_UNKNOWN, RAYS = range(5, 10)
COLUMNS = 10
"""Columns of what `add_crossings` adds up, and their number."""


@njit(cache=True, nogil=True)
def walk(
    origin: Any,
    direction: Any,
    reach: float,
    directory: Any,
    codes: Any,
    ends: Any,
    path: Any,
    voxels: Any,
) -> int:
    """Follow a ray through the grid to the first voxel that ends it.

    Args:
        origin: relative to the directory, tuple [voxels].
        direction: unit vector, tuple.
        reach: of the ray [voxels].
        directory: of a `VisibleField`.
        codes: of it.
        ends: whether a ray ends in a voxel, by code.
        path: receives the codes of the voxels.
        voxels: receives their indices relative to the directory, shape (n, 3).

    Returns:
        Number of voxels, the one that ends the ray included.
    """
    x, y, z = origin
    voxel, crossings, steps, deltas = begin_walk(x, y, z, direction[0], direction[1], direction[2])
    count, entered = 0, 0.0
    while entered < reach and count < len(path):
        i, j, k = voxel
        path[count] = code_at(directory, codes, i, j, k)
        voxels[count, 0], voxels[count, 1], voxels[count, 2] = i, j, k
        count += 1
        if ends[path[count - 1]]:
            break
        entered = way_through(crossings)
        voxel, crossings = next_voxel(voxel, crossings, steps, deltas)
    return count


@njit(cache=True, nogil=True)
def add_crossings(
    poses: Any,
    rays: Any,
    weights: Any,
    box: Any,
    reach: float,
    directory: Any,
    codes: Any,
    probabilities: Any,
    entropies: Any,
    known: Any,
    nearness: Any,
    first_near: Any,
    sums: Any,
) -> None:
    """Add up, for each pose, what its rays cross.

    Args:
        poses: T_map_camera, positions relative to the directory [voxels], shape (M, 4, 4).
        rays: unit directions in the camera frame, shape (N, 3).
        weights: of the rays, shape (N,).
        box: the region that counts, (low, high) corners relative to the directory [voxels].
        reach: of the rays [voxels].
        directory: of a `VisibleField`.
        codes: of it.
        probabilities: of occupancy by code.
        entropies: by code [bits].
        known: whether codes are of known voxels.
        nearness: of voxels to a surface.
        first_near: index of ``nearness[0, 0, 0]`` relative to the directory, shape (3,).
        sums: receives the sums, shape (M, COLUMNS).
    """
    longest = int(2.0 * reach) + 8  # a ray crosses at most sqrt(3) voxels per voxel of way
    path, voxels = np.empty(longest, np.uint8), np.empty((longest, 3), np.int64)
    inside = np.empty(longest, np.bool_)
    ends = known & (probabilities > 0.5)
    for view in range(len(poses)):
        origin = (poses[view, 0, 3], poses[view, 1, 3], poses[view, 2, 3])
        for ray in range(len(rays)):
            count = walk(
                origin, turned(poses[view], rays[ray]), reach, directory, codes, ends, path, voxels
            )
            for n in range(count):
                inside[n] = True
                for axis in range(3):
                    c = voxels[n, axis] + 0.5
                    inside[n] &= box[0, axis] <= c <= box[1, axis]
            out, weight = sums[view], weights[ray]
            _add_entropies(path[:count], inside, probabilities, entropies, known, ends, weight, out)
            _add_rear_side(path[:count], inside, probabilities, entropies, known, ends, weight, out)
            _add_first(path[:count], inside, known, ends, weight, out)
            out[PROXIMITY] += weight * _near(
                voxels[:count], path, inside, known, nearness, first_near
            )


@njit(cache=True, nogil=True)
def _add_entropies(
    path: Any, inside: Any, p: Any, entropies: Any, known: Any, ends: Any, weight: float, out: Any
) -> None:
    """Entropies of all voxels: as far as they are seen, and on average."""
    visible, total, count = 1.0, 0.0, 0
    for n in range(len(path)):
        code = path[n]
        if inside[n]:
            out[OCCLUSION_AWARE] += weight * visible * entropies[code]
            out[UNOBSERVED] += 0.0 if known[code] else weight * visible * entropies[code]
            total += entropies[code]
            count += 1
        visible *= 1.0 - p[code]
    if ends[path[-1]]:
        out[SURFACE_RAY_ENTROPY] += weight * total
        out[SURFACE_RAY_VOXELS] += weight * count


@njit(cache=True, nogil=True)
def _add_rear_side(
    path: Any, inside: Any, p: Any, entropies: Any, known: Any, ends: Any, weight: float, out: Any
) -> None:
    """Surfaces met from unknown space."""
    last = len(path) - 1
    if last < 1 or not ends[path[last]] or known[path[last - 1]] or not inside[last]:
        return
    visible, run = 1.0, 0.0
    for n in range(last):
        code = path[n]
        run = 0.0 if known[code] else run + (visible * entropies[code] if inside[n] else 0.0)
        visible *= 1.0 - p[code]
    out[REAR_SIDE] += weight
    out[REAR_SIDE_ENTROPY] += weight * (run + visible * entropies[path[last]])


@njit(cache=True, nogil=True)
def _add_first(path: Any, inside: Any, known: Any, ends: Any, weight: float, out: Any) -> None:
    """What a ray meets first: a surface, or the unknown behind free space."""
    out[RAYS] += weight
    n = 0
    while n < len(path) and not known[path[n]]:  # around the camera nothing may be known yet
        n += 1
    while n < len(path):
        code = path[n]
        if not known[code] or ends[code]:
            if inside[n]:
                out[FIRST_SURFACE if known[code] else FIRST_UNKNOWN] += weight
            return
        n += 1


@njit(cache=True, nogil=True)
def _near(voxels: Any, path: Any, inside: Any, known: Any, nearness: Any, first: Any) -> float:
    """Sum of the nearness of the unknown voxels of a ray."""
    nx, ny, nz = nearness.shape
    total = 0.0
    for n in range(len(voxels)):
        i, j, k = voxels[n, 0] - first[0], voxels[n, 1] - first[1], voxels[n, 2] - first[2]
        if 0 <= i < nx and 0 <= j < ny and 0 <= k < nz and inside[n] and not known[path[n]]:
            total += nearness[i, j, k]
    return total
