"""Complete search over a lattice of cells (x, y, heading): compiled kernels.

16 headings point exactly at neighbouring cells, up to a knight's move away, so that every way in
the graph can be driven as it is: one cell forwards or backwards, or a turn to the next heading.
Half-way poses of turns and of long moves are asked too.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from infomap_ros.motion.drive_kernels import BLOCKED, CLEAR, UNASKED, empty_lattice, wrapped
from infomap_ros.motion.quick_stance import is_good

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

_RING = 64  # buckets; more than the largest cost of a move


class DriveGraph(NamedTuple):
    """What is remembered of the graph, shape (nx, ny, 16) each.

    Attributes:
        nodes: whether the robot may stand in a cell's middle at a heading.
        turns: whether it may stand half-way to the next heading.
        moves: whether it may stand half-way of a knight's move forwards.
        costs: of the best way from the start, in units of 1/20 cell; -1 = not reached.
        origins: node from which a node is reached; itself for a node where ways begin.
    """

    nodes: NDArray[np.uint8]
    turns: NDArray[np.uint8]
    moves: NDArray[np.uint8]
    costs: NDArray[np.int32]
    origins: NDArray[np.int32]


def empty_graph(easy: NDArray[np.bool_]) -> DriveGraph:
    """A graph of which nothing was asked yet but the cells that are easy, shape (nx, ny)."""
    full = (*easy.shape, len(MOVES))
    nodes, turns, moves = (empty_lattice(easy, len(MOVES)) for _ in range(3))
    # The half-way pose of a knight's move lies at the edge of the cell half-way towards it.
    for h, (dx, dy) in enumerate(MOVES):
        half = np.roll(easy, (-int(dx / 2), -int(dy / 2)), axis=(0, 1))
        moves[:, :, h] = np.where(half, np.uint8(CLEAR), np.uint8(UNASKED))
    return DriveGraph(nodes, turns, moves, np.full(full, -1, np.int32), np.full(full, -1, np.int32))


@njit(cache=True, nogil=True)
def _ask_node(nodes: Any, i: int, j: int, h: int, grid: Any, ground: Any) -> Any:
    """State of a node that was not asked yet."""
    x, y = grid[0] + (i + 0.5) * grid[2], grid[1] + (j + 0.5) * grid[2]
    nodes[i, j, h] = CLEAR if is_good(ground, x, y, HEADINGS[h]) else BLOCKED
    return nodes[i, j, h]


@njit(cache=True, nogil=True)
def _ask_turn(turns: Any, i: int, j: int, h: int, grid: Any, ground: Any) -> Any:
    """State half-way from a heading to the next that was not asked yet."""
    half = 0.5 * ((HEADINGS[(h + 1) % 16] - HEADINGS[h]) % (2.0 * math.pi))
    x, y = grid[0] + (i + 0.5) * grid[2], grid[1] + (j + 0.5) * grid[2]
    turns[i, j, h] = CLEAR if is_good(ground, x, y, HEADINGS[h] + half) else BLOCKED
    return turns[i, j, h]


@njit(cache=True, nogil=True)
def _ask_move(moves: Any, i: int, j: int, h: int, grid: Any, ground: Any) -> Any:
    """State half-way of a knight's move forwards that was not asked yet."""
    u, v = i + 0.5 + 0.5 * MOVES[h, 0], j + 0.5 + 0.5 * MOVES[h, 1]
    x, y = grid[0] + u * grid[2], grid[1] + v * grid[2]
    moves[i, j, h] = CLEAR if is_good(ground, x, y, HEADINGS[h]) else BLOCKED
    return moves[i, j, h]


@njit(cache=True, nogil=True)
def flood(
    graph: Any, starts: Any, start_costs: Any, reverse: bool, turn_cost: float, grid: Any,
    ground: Any,
) -> int:  # fmt: skip
    """Find the best way to every node that can be reached (Dijkstra, Dial's buckets).

    Args:
        graph: a `DriveGraph`; its costs and origins are filled.
        starts: nodes where ways begin, flat indices, shape (S,).
        start_costs: cost of being there, increasing, shape (S,), int.
        reverse: whether driving backwards is allowed.
        turn_cost: of a turn, in cells per radian.
        grid: x, y of the corner of cell (0, 0) and edge of a cell [m, map].
        ground: a `Ground`.

    Returns:
        Number of nodes reached.
    """
    costs, origins = graph.costs.ravel(), graph.origins.ravel()
    costs[:], origins[:] = -1, -1
    nx, ny = graph.costs.shape[0], graph.costs.shape[1]
    nodes, halves, middles = graph.nodes, graph.turns, graph.moves
    turns, moves = _prices(turn_cost)
    # Entries of the buckets: node and the entry below it. One whose node has become cheaper since
    # stays and is passed over.
    bucket = np.full(_RING, -1, np.int64)
    entries = np.empty((len(starts) + 1024, 2), np.int64)
    count, waiting, reached, cost, begun = 0, 0, 0, 0, 0
    while waiting or begun < len(starts):
        while begun < len(starts) and start_costs[begun] < cost + _RING:
            node, total = starts[begun], start_costs[begun]
            begun += 1
            if costs[node] < 0 or total < costs[node]:
                costs[node], origins[node] = total, node
                entries[count, 0], entries[count, 1] = node, bucket[total % _RING]
                bucket[total % _RING] = count
                count, waiting = count + 1, waiting + 1
        entry = bucket[cost % _RING]
        if entry < 0:
            cost += 1
            continue
        node, bucket[cost % _RING] = entries[entry, 0], entries[entry, 1]
        waiting -= 1
        if costs[node] != cost:
            continue
        reached += 1
        if count + 4 > len(entries):
            entries = _doubled(entries)
        i, j, h = node // (ny * 16), node // 16 % ny, node % 16
        for edge in range(4 if reverse else 3):
            a, b, g = _neighbour(i, j, h, edge)
            if not (0 <= a < nx and 0 <= b < ny):
                continue
            other = (a * ny + b) * 16 + g
            total = cost + (turns[h if edge == 0 else g] if edge < 2 else moves[h])
            if 0 <= costs[other] <= total:
                continue
            state = nodes[a, b, g]
            state = _ask_node(nodes, a, b, g, grid, ground) if state == UNASKED else state
            if state == BLOCKED:
                continue
            if edge < 2:
                k = h if edge == 0 else g
                state = halves[i, j, k]
                state = _ask_turn(halves, i, j, k, grid, ground) if state == UNASKED else state
            elif abs(MOVES[h, 0]) + abs(MOVES[h, 1]) == 3:
                k, m = (i, j) if edge == 2 else (a, b)
                state = middles[k, m, h]
                state = _ask_move(middles, k, m, h, grid, ground) if state == UNASKED else state
            if state == BLOCKED:
                continue
            costs[other], origins[other] = total, node
            entries[count, 0], entries[count, 1] = other, bucket[total % _RING]
            bucket[total % _RING] = count
            count, waiting = count + 1, waiting + 1
    return reached


@njit(cache=True, nogil=True)
def _prices(turn_cost: float) -> Any:
    """Cost of the turn from each heading to the next, and of the move forwards in each heading."""
    turns, moves = np.empty(16, np.int64), np.empty(16, np.int64)
    for h in range(16):
        angle = abs(wrapped(HEADINGS[(h + 1) % 16] - HEADINGS[h]))
        turns[h] = min(max(1, round(UNITS * turn_cost * angle)), _RING - 1)
        moves[h] = round(UNITS * math.hypot(MOVES[h, 0], MOVES[h, 1]))
    return turns, moves


@njit(cache=True, nogil=True)
def _neighbour(i: int, j: int, h: int, edge: int) -> tuple[int, int, int]:
    """Cell and heading at the other end of an edge: 0, 1 turn left, right; 2, 3 drive."""
    if edge < 2:
        return i, j, (h + 1) % 16 if edge == 0 else (h + 15) % 16
    dx, dy = MOVES[h, 0], MOVES[h, 1]
    return (i + dx, j + dy, h) if edge == 2 else (i - dx, j - dy, h)


@njit(cache=True, nogil=True)
def _doubled(entries: Any) -> Any:
    larger = np.empty((2 * len(entries), 2), np.int64)
    larger[: len(entries)] = entries
    return larger
