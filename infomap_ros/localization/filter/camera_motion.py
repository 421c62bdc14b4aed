"""Rigid motions from three pairs of points, the smallest sample that gives one."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray


def random_triples(count: int, trials: int, seed: int) -> NDArray[np.int64]:
    """Triples of different numbers below count, shape (trials, 3)."""
    rng = np.random.default_rng(seed)
    first = rng.integers(0, count, trials)
    second = (first + rng.integers(1, count, trials)) % count
    third = (first + rng.integers(1, count, trials)) % count
    kept = third != second
    return np.column_stack([first, second, third])[kept]


@njit(cache=True, nogil=True)
def pose_of_triple(points, seen, triple):  # type: ignore[no-untyped-def]
    """Pose that takes the triangle of three points to that of the seen ones."""
    before_valid, before = _triangle_axes(points, triple)
    after_valid, after = _triangle_axes(seen, triple)
    rotation = after @ before.T
    middle = (points[triple[0]] + points[triple[1]] + points[triple[2]]) / 3.0
    middle_seen = (seen[triple[0]] + seen[triple[1]] + seen[triple[2]]) / 3.0
    return before_valid and after_valid, rotation, middle_seen - rotation @ middle


@njit(cache=True, nogil=True)
def _triangle_axes(points, triple):  # type: ignore[no-untyped-def]
    """Whether a triangle has an area, and its axes as columns, shape (3, 3)."""
    axes = np.eye(3)
    one = points[triple[1]] - points[triple[0]]
    two = points[triple[2]] - points[triple[0]]
    normal = np.cross(one, two)
    length, area = np.sqrt((one * one).sum()), np.sqrt((normal * normal).sum())
    if not area > 1e-2 * length * np.sqrt((two * two).sum()):
        return False, axes
    axes[:, 0] = one / length
    axes[:, 2] = normal / area
    axes[:, 1] = np.cross(axes[:, 2], axes[:, 0])
    return True, axes
