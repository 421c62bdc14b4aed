"""Which places of missing surface views are expected to show: kernels."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit

_END = 2.0  # [voxels] before a place, within which its own surface hides nothing
_STEP = 0.5  # [voxels]


@njit(cache=True, nogil=True)
def sight_weights(
    quanta: Any,
    hiding: float,
    positions: Any,
    places: Any,
    normals: Any,
    shares: Any,
    step: float,
    least_cosine: float,
    weights: Any,
) -> None:
    """Weight with which each place is seen from each position.

    Args:
        quanta: evidence of the voxels of a window, int16.
        hiding: evidence above which they hide what is behind.
        positions: of cameras, shape (P, 3), in voxels of the window.
        places: shape (N, 3), likewise.
        normals: there, shape (N, 3).
        shares: weight of what is seen squarely at distances of 0, `step`, 2 `step`...
        step: see shares [voxels].
        least_cosine: of the angle between normal and line of sight.
        weights: receives share times cosine, shape (P, N); 0 where hidden, turned away or far.
    """
    for p in range(len(positions)):
        for n in range(len(places)):
            x, y, z = (
                places[n, 0] - positions[p, 0],
                places[n, 1] - positions[p, 1],
                places[n, 2] - positions[p, 2],
            )
            length = np.sqrt(x * x + y * y + z * z)
            weights[p, n] = 0.0
            at = int(length / step)
            if length < 1e-6 or at >= len(shares) or shares[at] <= 0.0:
                continue
            cosine = -(x * normals[n, 0] + y * normals[n, 1] + z * normals[n, 2]) / length
            if cosine < least_cosine:
                continue
            way = x / length, y / length, z / length
            if _is_open(quanta, hiding, positions[p], way, length - _END):
                weights[p, n] = shares[at] * cosine


@njit(cache=True, nogil=True)
def _is_open(quanta: Any, hiding: float, start: Any, way: Any, length: float) -> bool:
    """Whether no voxel that hides is on a way; what is beyond the window is open."""
    for k in range(1, int(length / _STEP) + 1):
        i = int(np.floor(start[0] + k * _STEP * way[0]))
        j = int(np.floor(start[1] + k * _STEP * way[1]))
        m = int(np.floor(start[2] + k * _STEP * way[2]))
        if i < 0 or j < 0 or m < 0:
            continue
        if i >= quanta.shape[0] or j >= quanta.shape[1] or m >= quanta.shape[2]:
            continue
        if quanta[i, j, m] > hiding:
            return False
    return True


@njit(cache=True, nogil=True)
def sums_in_view(
    positions: Any, rotations: Any, places: Any, weights: Any, lens: Any, sums: Any
) -> None:
    """Sum of the weights of the places in each image.

    Args:
        positions: shape (P, 3).
        rotations: ``R_map_camera``, shape (P, O, 3, 3).
        places: shape (N, 3), in the unit of the positions.
        weights: shape (P, N).
        lens: fx, fy, cx, cy, width and height [px].
        sums: receives the sums, shape (P, O).
    """
    fx, fy, cx, cy, width, height = lens
    for p in range(len(positions)):
        for o in range(rotations.shape[1]):
            total = 0.0
            for n in range(len(places)):
                if weights[p, n] <= 0.0:
                    continue
                u = v = depth = 0.0
                for i in range(3):
                    gap = places[n, i] - positions[p, i]
                    u += rotations[p, o, i, 0] * gap
                    v += rotations[p, o, i, 1] * gap
                    depth += rotations[p, o, i, 2] * gap
                if depth <= 0.0:
                    continue
                u, v = fx * u / depth + cx, fy * v / depth + cy
                if -0.5 <= u < width - 0.5 and -0.5 <= v < height - 0.5:
                    total += weights[p, n]
            sums[p, o] = total
