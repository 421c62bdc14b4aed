"""Driving of a robot that turns in place: turn, drive straight, turn. Compiled kernels.

Whether it may stand somewhere is asked of a lattice of cells (x, y, heading) that remembers the
answers of `infomap_ros.motion.base.stance` for the cells' middles.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from infomap_ros.geometry.kernel import kernel
from infomap_ros.motion.base.quick_stance import is_good

UNASKED, CLEAR, BLOCKED = 0, 1, 2
"""States of a cell of the lattice."""


def empty_lattice(easy: NDArray[np.bool_], headings: int) -> NDArray[np.uint8]:
    """A lattice of which no cell was asked yet but those that are easy, shape (nx, ny)."""
    states = np.where(easy, np.uint8(CLEAR), np.uint8(UNASKED))
    return np.repeat(states[:, :, None], headings, axis=2)


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
def cell_of(shape: Any, grid: Any, x: float, y: float, yaw: float) -> tuple[int, int, int]:
    """Cell of the lattice that holds a place; i = -1 outside. grid: x, y of its corner, edge."""
    nx, ny, headings = shape
    u, v = (x - grid[0]) / grid[2], (y - grid[1]) / grid[2]
    if not (0.0 <= u < nx and 0.0 <= v < ny):
        return -1, 0, 0
    k = math.floor(yaw * headings / (2.0 * math.pi) + 0.5) % headings
    return int(u), int(v), k


@kernel
def known_drive(lattice: Any, grid: Any, a: Any, b: Any, reverse: bool) -> int:
    """Whether the way from a to b is CLEAR or BLOCKED; UNASKED where a cell was not asked yet."""
    angle = 2.0 * math.pi / lattice.shape[2]
    legs = legs_of(a[0], a[1], a[2], b[0], b[1], b[2], reverse)
    counts = counts_of(legs[0], legs[1], legs[2], grid[2], angle)
    for step in range(counts[0] + counts[1] + counts[2] + 1):
        x, y, yaw = pose_at(a, b, legs, counts, step)
        i, j, k = cell_of(lattice.shape, grid, x, y, yaw)
        state = lattice[i, j, k] if i >= 0 else BLOCKED
        if state != CLEAR:
            return state
    return CLEAR


@kernel
def known_drive_in_cells(
    lattice: Any,
    ax: float,
    ay: float,
    ayaw: float,
    bx: float,
    by: float,
    byaw: float,
    reverse: bool,
) -> int:
    """As `known_drive`, in cells from the grid's corner; with the fewest arguments to unpack."""
    return known_drive(lattice, (0.0, 0.0, 1.0), (ax, ay, ayaw), (bx, by, byaw), reverse)


@kernel
def ask_cell(
    lattice: Any, grid: Any, i: int, j: int, k: int, ground: Any,
) -> int:  # fmt: skip
    """State of a cell, found now if need be."""
    if lattice[i, j, k] == UNASKED:
        x, y = grid[0] + (i + 0.5) * grid[2], grid[1] + (j + 0.5) * grid[2]
        yaw = 2.0 * math.pi * k / lattice.shape[2]
        good = is_good(ground, x, y, yaw)
        lattice[i, j, k] = CLEAR if good else BLOCKED
    return int(lattice[i, j, k])


@kernel
def ask_drive(
    lattice: Any, grid: Any, a: Any, b: Any, reverse: bool, ground: Any,
) -> int:  # fmt: skip
    """As `known_drive`, with cells asked where need be."""
    angle = 2.0 * math.pi / lattice.shape[2]
    legs = legs_of(a[0], a[1], a[2], b[0], b[1], b[2], reverse)
    counts = counts_of(legs[0], legs[1], legs[2], grid[2], angle)
    for step in range(counts[0] + counts[1] + counts[2] + 1):
        x, y, yaw = pose_at(a, b, legs, counts, step)
        i, j, k = cell_of(lattice.shape, grid, x, y, yaw)
        if i < 0 or ask_cell(lattice, grid, i, j, k, ground) != CLEAR:
            return BLOCKED
    return CLEAR


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
