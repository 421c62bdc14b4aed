"""Driving of a robot that turns in place: turn, drive straight, turn. Compiled kernels."""

from __future__ import annotations

import math
from typing import Any

from infomap_ros.geometry.kernel import kernel
from infomap_ros.motion.base.stance import is_good


@kernel
def wrapped(angle: float) -> float:
    """The same angle within -pi .. pi [rad]."""
    return angle - 2.0 * math.pi * math.floor((angle + math.pi) / (2.0 * math.pi))


@kernel
def legs_of(
    ax: float, ay: float, ayaw: float, bx: float, by: float, byaw: float, reverse: bool
) -> tuple[float, float, float]:
    """First turn [rad], length [m] and last turn [rad] of the way from a to b.

    Of driving forwards and, where allowed, backwards that with the smaller turns.
    """
    length = math.hypot(bx - ax, by - ay)
    if length < 1e-6:
        return wrapped(byaw - ayaw), 0.0, 0.0
    heading = math.atan2(by - ay, bx - ax)
    first, last = wrapped(heading - ayaw), wrapped(byaw - heading)
    if reverse and abs(first) + abs(last) > math.pi + 1e-9:
        return wrapped(first + math.pi), length, wrapped(last + math.pi)
    return first, length, last


@kernel
def counts_of(first: float, length: float, last: float, spacing: float, angle: float) -> Any:
    """Steps of the three legs, none longer than `spacing` [m] or `angle` [rad]."""
    return (
        math.ceil(abs(first) / angle - 1e-9),
        math.ceil(length / spacing - 1e-9),
        math.ceil(abs(last) / angle - 1e-9),
    )


@kernel
def pose_at(a: Any, b: Any, legs: Any, counts: Any, step: int) -> tuple[float, float, float]:
    """Place after a number of steps of the way from a to b."""
    turn, drive, last = counts
    heading = a[2] + legs[0]
    if step <= turn:
        share = step / turn if turn else 0.0
        return a[0], a[1], a[2] + share * legs[0]
    if step <= turn + drive:
        share = (step - turn) / drive
        return a[0] + share * (b[0] - a[0]), a[1] + share * (b[1] - a[1]), heading
    return b[0], b[1], heading + (step - turn - drive) / last * legs[2]


@kernel
def drives_well(
    places: Any, reverse: bool, spacing: float, angle: float, ground: Any, fault: Any,
) -> bool:  # fmt: skip
    """Drive through places, shape (K, 3), and ask every stance on the way itself.

    Returns:
        Whether all are good; if not, `fault` holds the place of the first that is not.
    """
    for n in range(max(len(places) - 1, 1)):
        a, b = places[n], places[min(n + 1, len(places) - 1)]
        legs = legs_of(a[0], a[1], a[2], b[0], b[1], b[2], reverse)
        counts = counts_of(legs[0], legs[1], legs[2], spacing, angle)
        for step in range(counts[0] + counts[1] + counts[2] + 1):
            fault[0], fault[1], fault[2] = pose_at(a, b, legs, counts, step)
            if not is_good(ground, fault[0], fault[1], fault[2]):
                return False
    return True
