"""Making a way shorter that was found by sampling or on a lattice: compiled kernels."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numba import njit

from infomap_ros.motion.base.drive_kernels import CLEAR, ask_drive, counts_of, legs_of, pose_at


@njit(cache=True, nogil=True)
def drive_cost(a: Any, b: Any, reverse: bool, turn_cost: float) -> float:
    """Length of the way from a to b [m], its turns counted at `turn_cost` [m/rad]."""
    first, length, last = legs_of(a[0], a[1], a[2], b[0], b[1], b[2], reverse)
    return length + turn_cost * (abs(first) + abs(last))


@njit(cache=True, nogil=True)
def _is_clear(
    a: Any,
    b: Any,
    lattice: Any,
    grid: Any,
    reverse: bool,
    ground: Any,
) -> bool:
    return ask_drive(lattice, grid, a, b, reverse, ground) == CLEAR


@njit(cache=True, nogil=True)
def best_subset(
    places: Any, lattice: Any, grid: Any, reverse: bool, turn_cost: float, ground: Any,
) -> Any:  # fmt: skip
    """The cheapest way from first to last place through some of them, in order.

    Every pair of places is tried that would lower the cost, by dynamic programming. The way from
    each place to the next is taken as good.

    Args:
        places: shape (K, 3).
        lattice: of cells, as in `drive_kernels`.
        grid: corner and edge of its cells.
        reverse: whether driving backwards is allowed.
        turn_cost: [m/rad].
        ground: a `Ground`.

    Returns:
        Indices of the places kept, increasing.
    """
    count = len(places)
    cost, origin = np.full(count, math.inf), np.zeros(count, np.int64)
    cost[0] = 0.0
    for n in range(1, count):
        for m in range(n - 1, -1, -1):
            total = cost[m] + drive_cost(places[m], places[n], reverse, turn_cost)
            if total >= cost[n] - 1e-9:
                continue
            a, b, known = places[m], places[n], m == n - 1
            if known or _is_clear(a, b, lattice, grid, reverse, ground):
                cost[n], origin[n] = total, m
    kept = np.empty(count, np.int64)
    found, n = 0, count - 1
    while n > 0:
        kept[found] = n
        found += 1
        n = origin[n]
    kept[found] = 0
    return kept[: found + 1][::-1].copy()


@njit(cache=True, nogil=True)
def straighten_headings(
    places: Any,
    lattice: Any,
    grid: Any,
    reverse: bool,
    ground: Any,
) -> None:
    """Let the robot keep, at places on the way, the heading in which it arrives, where it may."""
    trial = np.empty(3)
    for n in range(1, len(places) - 1):
        a, b, c = places[n - 1], places[n], places[n + 1]
        first, length, _ = legs_of(a[0], a[1], a[2], b[0], b[1], b[2], reverse)
        if length == 0.0:
            continue
        trial[0], trial[1], trial[2] = b[0], b[1], a[2] + first
        if _is_clear(a, trial, lattice, grid, reverse, ground) and _is_clear(
            trial, c, lattice, grid, reverse, ground
        ):
            places[n, 2] = trial[2]


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
