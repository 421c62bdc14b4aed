"""Complete search over a lattice of cells (x, y, heading): compiled kernels.

16 headings point exactly at neighboring cells, up to a knight's move away, so that every way in
the graph can be driven as it is: one move forwards or backwards, or a turn to the next heading, in
place or on an arc that leads to another cell's middle. Stances in between are asked too, one per
edge of a cell and per step of a turn.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from infomap_ros.geometry.kernel import kernel
from infomap_ros.motion.base.drive_arcs import arc_points
from infomap_ros.motion.base.drive_kernels import wrapped
from infomap_ros.motion.base.stance import is_good

UNASKED, CLEAR, BLOCKED = 0, 1, 2
"""States of a node, a turn or a move."""

MOVES = np.array(
    [
        (1, 0), (2, 1), (1, 1), (1, 2), (0, 1), (-1, 2), (-1, 1), (-2, 1),
        (-1, 0), (-2, -1), (-1, -1), (-1, -2), (0, -1), (1, -2), (1, -1), (2, -1),
    ],
    dtype=np.int64,
)  # fmt: skip
"""Cells by which the robot moves forwards at each of the 16 headings."""

HEADINGS = np.arctan2(MOVES[:, 1], MOVES[:, 0]).astype(np.float64)
"""Angles of the headings [rad]."""

UNITS = 20
"""Units of cost per cell edge."""

IN_PLACE = np.zeros((2, 16, 2), np.int64)
"""Displacement of a turn to the left (0) or right (1) from each heading, for turns in place."""


def arc_moves(radius: float) -> NDArray[np.int64]:
    """Displacement of the smallest turns on an arc of at least a radius, all in cells.

    A turn goes as many moves along its first heading as along its second.

    Returns:
        To the left (0) and right (1) from each heading, shape (2, 16, 2).
    """
    moves = IN_PLACE.copy()
    lengths = np.hypot(*MOVES.T)
    for side, step in enumerate((1, -1)):
        for h in range(16):
            g = (h + step) % 16
            half = 0.5 * abs(wrapped(HEADINGS[g] - HEADINGS[h]))
            count = math.ceil(radius * math.tan(half) / min(lengths[h], lengths[g]) - 1e-9)
            moves[side, h] = count * (MOVES[h] + MOVES[g])
    return moves


class DriveGraph(NamedTuple):
    """What is remembered of the graph, shape (nx, ny, 16) each.

    Attributes:
        nodes: whether the robot may stand in a cell's middle at a heading.
        turns: whether it may turn left to the next heading, in place or on an arc.
        rights: likewise right on an arc; empty for turns in place, which are the same back.
        moves: whether it may move forwards to the next cell in its heading.
        costs: of the best way from the start, in units of 1/20 cell; -1 = not reached.
        origins: node from which a node is reached; itself for a node where ways begin.
    """

    nodes: NDArray[np.uint8]
    turns: NDArray[np.uint8]
    rights: NDArray[np.uint8]
    moves: NDArray[np.uint8]
    costs: NDArray[np.int32]
    origins: NDArray[np.int32]


def empty_graph(cells: tuple[int, ...], in_place: bool = True) -> DriveGraph:
    """A graph over (nx, ny) cells of which nothing was asked yet."""
    full = (*cells, len(MOVES))
    nodes, turns, moves = (np.full(full, UNASKED, np.uint8) for _ in range(3))
    rights = np.full((1, 1, 1) if in_place else full, UNASKED, np.uint8)
    costs, origins = np.full(full, -1, np.int32), np.full(full, -1, np.int32)
    return DriveGraph(nodes, turns, rights, moves, costs, origins)


@kernel
def ask_node(nodes: Any, i: int, j: int, h: int, grid: Any, ground: Any) -> Any:
    """State of a node that was not asked yet."""
    x, y = grid[0] + (i + 0.5) * grid[2], grid[1] + (j + 0.5) * grid[2]
    nodes[i, j, h] = CLEAR if is_good(ground, x, y, HEADINGS[h]) else BLOCKED
    return nodes[i, j, h]


@njit(cache=True, nogil=True)
def ask_turn(
    turns: Any, i: int, j: int, h: int, step: int, dx: int, dy: int, grid: Any, ground: Any
) -> Any:
    """State of the turn from a heading to the next that was not asked yet."""
    x, y, edge = grid[0] + (i + 0.5) * grid[2], grid[1] + (j + 0.5) * grid[2], grid[2]
    turn = wrapped(HEADINGS[(h + step) % 16] - HEADINGS[h])
    turns[i, j, h] = CLEAR
    if dx == 0 and dy == 0:
        count = math.ceil(abs(turn) / grid[3] - 1e-9)
        for n in range(1, count):
            if not is_good(ground, x, y, HEADINGS[h] + turn * n / count):
                turns[i, j, h] = BLOCKED
                break
        return turns[i, j, h]
    ends = (x, y, HEADINGS[h]), (x + dx * edge, y + dy * edge, HEADINGS[h] + turn)
    points = arc_points(ends[0], ends[1], edge)
    for n in range(1, len(points) - 1):
        if not is_good(ground, points[n, 0], points[n, 1], points[n, 2]):
            turns[i, j, h] = BLOCKED
            break
    return turns[i, j, h]


@kernel
def ask_move(moves: Any, i: int, j: int, h: int, grid: Any, ground: Any) -> Any:
    """State of what lies on a move forwards that was not asked yet."""
    dx, dy, edge = MOVES[h, 0], MOVES[h, 1], grid[2]
    count = math.ceil(math.hypot(dx, dy) - 1e-9)
    moves[i, j, h] = CLEAR
    for n in range(1, count):
        x = grid[0] + (i + 0.5 + dx * n / count) * edge
        y = grid[1] + (j + 0.5 + dy * n / count) * edge
        if not is_good(ground, x, y, HEADINGS[h]):
            moves[i, j, h] = BLOCKED
            break
    return moves[i, j, h]
