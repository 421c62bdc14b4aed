"""Cost of a path that turns in place, and its points: compiled kernels."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit

from infomap_ros.motion.base.drive_kernels import counts_of, legs_of, pose_at


@njit(cache=True, nogil=True)
def drive_cost(a: Any, b: Any, reverse: bool, turn_cost: float) -> float:
    """Length of the way from a to b [m], its turns counted at `turn_cost` [m/rad]."""
    first, length, last = legs_of(a[0], a[1], a[2], b[0], b[1], b[2], reverse)
    return length + turn_cost * (abs(first) + abs(last))


@njit(cache=True, nogil=True)
def points_along(places: Any, reverse: bool, spacing: float, angle: float) -> Any:
    """The way through places, shape (K, 3), in steps of at most `spacing` [m] and `angle` [rad]."""
    total = 1
    for n in range(len(places) - 1):
        a, b = places[n], places[n + 1]
        legs = legs_of(a[0], a[1], a[2], b[0], b[1], b[2], reverse)
        counts = counts_of(legs[0], legs[1], legs[2], spacing, angle)
        total += counts[0] + counts[1] + counts[2]
    points = np.empty((total, 3))
    points[0] = places[0]
    row = 1
    for n in range(len(places) - 1):
        a, b = places[n], places[n + 1]
        legs = legs_of(a[0], a[1], a[2], b[0], b[1], b[2], reverse)
        counts = counts_of(legs[0], legs[1], legs[2], spacing, angle)
        for step in range(1, counts[0] + counts[1] + counts[2] + 1):
            x, y, yaw = pose_at(a, b, legs, counts, step)
            points[row, 0], points[row, 1], points[row, 2] = x, y, yaw
            row += 1
    return points
