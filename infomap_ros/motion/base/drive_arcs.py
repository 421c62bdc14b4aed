"""Ways of a vehicle that cannot turn in place: compiled kernels.

Two places of different heading are linked by a straight line, an arc and a straight line, one of
the lines of length zero: the arc is tangent to the lines on which the headings lie.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numba import njit

from infomap_ros.motion.base.drive_kernels import wrapped


@njit(cache=True, nogil=True)
def arc_between(a: Any, b: Any) -> Any:
    """Line before, turn, radius, line after from a to b; lengths negative backwards [m, rad].

    The radius is 0 where the places are on one line, NaN where no such way links them.
    """
    dx, dy, turn = b[0] - a[0], b[1] - a[1], wrapped(b[2] - a[2])
    ux, uy = math.cos(a[2]), math.sin(a[2])
    if abs(turn) < 1e-9:
        ahead, aside = dx * ux + dy * uy, dy * ux - dx * uy
        return ahead, 0.0, 0.0 if abs(aside) < 1e-6 else math.nan, 0.0
    vx, vy = math.cos(b[2]), math.sin(b[2])
    before = (dx * vy - dy * vx) / math.sin(turn)
    after = (ux * dy - uy * dx) / math.sin(turn)
    tangent = min(abs(before), abs(after))
    radius = tangent / math.tan(0.5 * abs(turn)) if before * after > 0.0 else math.nan
    sign = 1.0 if before > 0.0 else -1.0
    return before - sign * tangent, turn, radius, after - sign * tangent


@njit(cache=True, nogil=True)
def arc_points(a: Any, b: Any, spacing: float) -> Any:
    """The way from a to b in equal steps of at most `spacing` [m], both included, shape (n, 3)."""
    before, turn, radius, after = arc_between(a, b)
    backwards = before < 0.0 or after < 0.0 or _goes_back(a, b)
    sign = -1.0 if backwards else 1.0
    length = abs(before) + radius * abs(turn) + abs(after)
    count = max(1, math.ceil(length / spacing - 1e-9))
    points = np.empty((count + 1, 3))
    side = sign * math.copysign(1.0, turn)
    x, y = a[0] + before * math.cos(a[2]), a[1] + before * math.sin(a[2])
    cx, cy = x - side * radius * math.sin(a[2]), y + side * radius * math.cos(a[2])
    for n in range(count + 1):
        along = length * n / count
        if along <= abs(before):
            points[n, 0] = a[0] + sign * along * math.cos(a[2])
            points[n, 1] = a[1] + sign * along * math.sin(a[2])
            points[n, 2] = a[2]
            continue
        left = length - along
        yaw = a[2] + turn
        if left < abs(after) or radius == 0.0:
            points[n, 0] = b[0] - sign * left * math.cos(yaw)
            points[n, 1] = b[1] - sign * left * math.sin(yaw)
        else:
            yaw = a[2] + math.copysign((along - abs(before)) / radius, turn)
            points[n, 0] = cx + side * radius * math.sin(yaw)
            points[n, 1] = cy - side * radius * math.cos(yaw)
        points[n, 2] = yaw
    return points


@njit(cache=True, nogil=True)
def _goes_back(a: Any, b: Any) -> bool:
    middle = a[2] + 0.5 * wrapped(b[2] - a[2])
    return (b[0] - a[0]) * math.cos(middle) + (b[1] - a[1]) * math.sin(middle) < 0.0
