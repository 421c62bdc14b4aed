"""Compiled part of `error_prediction`: what is in view of waypoints, and what it tells of the end.

A chain of camera poses x_1 ... x_K, each an error (dt, dtheta) of `geometry.transforms`, is tied
together by the motion prior and by fiducials that are seen from several of them. Each fiducial is
eliminated, which couples the poses that see it, then all poses but the last.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit

POSE = 6
"""Errors of a pose."""


@njit(cache=True, nogil=True)
def in_view(centers: Any, rotations: Any, points: Any, camera: Any, limits: Any, out: Any) -> None:
    """Which points project into the image.

    Args:
        centers: of the camera, shape (M, K, 3) [m].
        rotations: R_map_camera, shape (M, K, 3, 3).
        points: shape (N, 3) [m].
        camera: fx, fy, cx, cy, width, height, border [px].
        limits: smallest and largest depth [m].
        out: shape (M, K, N), bool.
    """
    fx, fy, cx, cy, width, height, border = camera
    for m in range(centers.shape[0]):
        for k in range(centers.shape[1]):
            turn = rotations[m, k]
            for n in range(len(points)):
                a = points[n, 0] - centers[m, k, 0]
                b = points[n, 1] - centers[m, k, 1]
                c = points[n, 2] - centers[m, k, 2]
                z = turn[0, 2] * a + turn[1, 2] * b + turn[2, 2] * c
                out[m, k, n] = False
                if not limits[0] <= z <= limits[1]:
                    continue
                u = fx * (turn[0, 0] * a + turn[1, 0] * b + turn[2, 0] * c) / z + cx
                v = fy * (turn[0, 1] * a + turn[1, 1] * b + turn[2, 1] * c) / z + cy
                across = border <= u <= width - 1.0 - border
                out[m, k, n] = across and border <= v <= height - 1.0 - border


@njit(cache=True, nogil=True)
def end_information(
    chain: Any, centers: Any, rotations: Any, points: Any, known: Any, weights: Any, sight: Any,
    camera: Any, precisions: Any, out: Any,
) -> None:  # fmt: skip
    """Information matrices of the last poses.

    Args:
        chain: information of the poses from the motion alone, shape (M, 6 K, 6 K); overwritten.
        centers: of the camera, shape (M, K, 3) [m].
        rotations: R_map_camera, shape (M, K, 3, 3).
        points: shape (N, 3) [m].
        known: information about the points before, shape (N, 3, 3) [1/m^2].
        weights: for how many each point stands, shape (N,).
        sight: which points are seen, shape (M, K, N), bool.
        camera: fx, fy [px], as in `in_view`.
        precisions: 1 / variance of u and v [1/px^2] and of the inverse depth [m^2].
        out: shape (M, 6, 6).
    """
    steps = centers.shape[1]
    levers, measured = np.empty((steps, 3)), np.empty((steps, 3, 3))
    total = np.empty((3, 3))
    for m in range(len(chain)):
        for n in range(len(points)):
            seen = 0
            total[:] = known[n]
            for k in range(steps):
                if not sight[m, k, n]:
                    continue
                levers[k] = points[n] - centers[m, k]
                _point_information(levers[k], rotations[m, k], camera, precisions, measured[k])
                measured[k] *= weights[n]
                total += measured[k]
                seen += 1
            if seen > 0:
                _couple(chain[m], sight[m, :, n], levers, measured, _inverse(total))
        _eliminate(chain[m], POSE * (steps - 1))
        out[m] = chain[m, POSE * (steps - 1) :, POSE * (steps - 1) :]


@njit(cache=True, nogil=True)
def _point_information(lever: Any, turn: Any, camera: Any, precisions: Any, out: Any) -> None:
    """What (u, v, 1/z) of one point tell of its place relative to the camera, map axes, (3, 3)."""
    x = turn[0, 0] * lever[0] + turn[1, 0] * lever[1] + turn[2, 0] * lever[2]
    y = turn[0, 1] * lever[0] + turn[1, 1] * lever[1] + turn[2, 1] * lever[2]
    z = turn[0, 2] * lever[0] + turn[1, 2] * lever[1] + turn[2, 2] * lever[2]
    row = np.empty(3)
    out[:] = 0.0
    for i in range(3):
        for axis in range(3):
            if i == 0:
                row[axis] = camera[0] / z * (turn[axis, 0] - x / z * turn[axis, 2])
            elif i == 1:
                row[axis] = camera[1] / z * (turn[axis, 1] - y / z * turn[axis, 2])
            else:
                row[axis] = -turn[axis, 2] / (z * z)
        for a in range(3):
            for b in range(3):
                out[a, b] += precisions[i] * row[a] * row[b]


@njit(cache=True, nogil=True)
def _couple(chain: Any, sight: Any, levers: Any, weights: Any, spread: Any) -> None:
    """Add a fiducial that is eliminated: E_k^T (W_k [k = j] - W_k A^-1 W_j) E_j for all k, j.

    With E = [-I, skew(lever)], by which pose errors move the point as seen from the camera.
    """
    for k in range(len(sight)):
        if not sight[k]:
            continue
        for j in range(len(sight)):
            if sight[j]:
                middle = -(weights[k] @ spread @ weights[j])
                if k == j:
                    middle += weights[k]
                right = _times_skew(middle, levers[j])
                block = chain[POSE * k : POSE * k + POSE, POSE * j : POSE * j + POSE]
                block[:3, :3] += middle
                block[:3, 3:] -= right
                block[3:, :3] -= _times_skew(middle.T, levers[k]).T
                block[3:, 3:] += _times_skew(right.T, levers[k]).T


@njit(cache=True, nogil=True)
def _times_skew(matrix: Any, vector: Any) -> Any:
    """``matrix @ skew(vector)``, shape (3, 3)."""
    out = np.empty((3, 3))
    for i in range(3):
        out[i, 0] = matrix[i, 1] * vector[2] - matrix[i, 2] * vector[1]
        out[i, 1] = matrix[i, 2] * vector[0] - matrix[i, 0] * vector[2]
        out[i, 2] = matrix[i, 0] * vector[1] - matrix[i, 1] * vector[0]
    return out


@njit(cache=True, nogil=True)
def _inverse(matrix: Any) -> Any:
    """Inverse of a symmetric positive definite matrix, shape (3, 3)."""
    a, b, c = matrix[0, 0], matrix[0, 1], matrix[0, 2]
    d, e, f = matrix[1, 1], matrix[1, 2], matrix[2, 2]
    out = np.empty((3, 3))
    out[0, 0], out[0, 1], out[0, 2] = d * f - e * e, c * e - b * f, b * e - c * d
    out[1, 1], out[1, 2], out[2, 2] = a * f - c * c, b * c - a * e, a * d - b * b
    determinant = a * out[0, 0] + b * out[0, 1] + c * out[0, 2]
    out[1, 0], out[2, 0], out[2, 1] = out[0, 1], out[0, 2], out[1, 2]
    return out / determinant


@njit(cache=True, nogil=True)
def _eliminate(matrix: Any, count: int) -> None:
    """Schur complement of the first rows and columns, in place, by symmetric elimination."""
    size = len(matrix)
    for pivot in range(count):
        for row in range(pivot + 1, size):
            factor = matrix[row, pivot] / matrix[pivot, pivot]
            if factor != 0.0:
                for column in range(pivot + 1, size):
                    matrix[row, column] -= factor * matrix[pivot, column]
