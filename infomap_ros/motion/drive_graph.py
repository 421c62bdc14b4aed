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
def _asked(
    table: Any, i: int, j: int, h: int, u: float, v: float, yaw: float, grid: Any, ground: Any,
) -> bool:  # fmt: skip
    """Remembered answer of a table, or that for the place (u, v) [cells]."""
    if table[i, j, h] == UNASKED:
        x, y = grid[0] + u * grid[2], grid[1] + v * grid[2]
        good = is_good(ground, x, y, yaw)
        table[i, j, h] = CLEAR if good else BLOCKED
    return table[i, j, h] == CLEAR


@njit(cache=True, nogil=True)
def node_is_clear(
    graph: Any,
    i: int,
    j: int,
    h: int,
    grid: Any,
    ground: Any,
) -> bool:
    """Whether the robot may stand in the middle of a cell at a heading."""
    return _asked(graph.nodes, i, j, h, i + 0.5, j + 0.5, HEADINGS[h], grid, ground)


@njit(cache=True, nogil=True)
def _edge_is_clear(
    graph: Any, i: int, j: int, h: int, edge: int, grid: Any, ground: Any,
) -> bool:  # fmt: skip
    """Whether the half-way pose of an edge is good; edges 0, 1 turn left, right; 2, 3 drive."""
    if edge < 2:
        k = h if edge == 0 else (h + 15) % 16
        following = HEADINGS[(k + 1) % 16]
        half = 0.5 * ((following - HEADINGS[k]) % (2.0 * math.pi))
        u, v, yaw = i + 0.5, j + 0.5, HEADINGS[k] + half
        return _asked(graph.turns, i, j, k, u, v, yaw, grid, ground)
    dx, dy = MOVES[h, 0], MOVES[h, 1]
    if abs(dx) + abs(dy) < 3:
        return True
    a, b = (i, j) if edge == 2 else (i - dx, j - dy)
    u, v = a + 0.5 + 0.5 * dx, b + 0.5 + 0.5 * dy
    return _asked(graph.moves, a, b, h, u, v, HEADINGS[h], grid, ground)


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
    nx, ny = graph.nodes.shape[0], graph.nodes.shape[1]
    bucket = np.full(_RING, -1, np.int64)
    following = np.full(len(costs), -1, np.int64)
    preceding = np.full(len(costs), -1, np.int64)
    settled = np.zeros(len(costs), np.bool_)
    waiting, reached, cost, begun = 0, 0, 0, 0
    while waiting or begun < len(starts):
        while begun < len(starts) and start_costs[begun] < cost + _RING:
            node, total = starts[begun], start_costs[begun]
            begun += 1
            if costs[node] < 0 or (total < costs[node] and not settled[node]):
                waiting += _lower(costs, bucket, following, preceding, node, total)
                origins[node] = node
        node = bucket[cost % _RING]
        if node < 0:
            cost += 1
            continue
        _leave(bucket, following, preceding, cost % _RING, node)
        settled[node] = True
        waiting, reached = waiting - 1, reached + 1
        i, j, h = node // (ny * 16), node // 16 % ny, node % 16
        for edge in range(4 if reverse else 3):
            a, b, g, price = _neighbour(i, j, h, edge, turn_cost)
            if not (0 <= a < nx and 0 <= b < ny):
                continue
            other = (a * ny + b) * 16 + g
            total = cost + price
            if settled[other] or 0 <= costs[other] <= total:
                continue
            if not node_is_clear(graph, a, b, g, grid, ground):
                continue
            if not _edge_is_clear(graph, i, j, h, edge, grid, ground):
                continue
            waiting += _lower(costs, bucket, following, preceding, other, total)
            origins[other] = node
    return reached


@njit(cache=True, nogil=True)
def _neighbour(i: int, j: int, h: int, edge: int, turn_cost: float) -> Any:
    """Cell, heading and cost at the other end of an edge."""
    if edge < 2:
        g = (h + 1) % 16 if edge == 0 else (h + 15) % 16
        angle = abs(wrapped(HEADINGS[g] - HEADINGS[h]))
        return i, j, g, min(max(1, round(UNITS * turn_cost * angle)), _RING - 1)
    dx, dy = MOVES[h, 0], MOVES[h, 1]
    price = round(UNITS * math.hypot(dx, dy))
    return (i + dx, j + dy, h, price) if edge == 2 else (i - dx, j - dy, h, price)


@njit(cache=True, nogil=True)
def _lower(costs: Any, bucket: Any, following: Any, preceding: Any, node: int, cost: int) -> int:
    """Give a node a lower cost; 1 if it was not waiting before, else 0."""
    known = costs[node] >= 0
    if known:
        _leave(bucket, following, preceding, costs[node] % _RING, node)
    costs[node] = cost
    _enter(bucket, following, preceding, cost % _RING, node)
    return 0 if known else 1


@njit(cache=True, nogil=True)
def _enter(bucket: Any, following: Any, preceding: Any, slot: int, node: int) -> None:
    first = bucket[slot]
    following[node], preceding[node] = first, -1
    if first >= 0:
        preceding[first] = node
    bucket[slot] = node


@njit(cache=True, nogil=True)
def _leave(bucket: Any, following: Any, preceding: Any, slot: int, node: int) -> None:
    before, after = preceding[node], following[node]
    if before >= 0:
        following[before] = after
    else:
        bucket[slot] = after
    if after >= 0:
        preceding[after] = before
