"""The best ways from a start to all nodes of a `DriveGraph`: compiled kernels."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numba import njit

from infomap_ros.motion.base.drive_graph import (
    BLOCKED,
    HEADINGS,
    MOVES,
    UNASKED,
    UNITS,
    ask_move,
    ask_node,
    ask_turn,
)
from infomap_ros.motion.base.drive_kernels import wrapped

NOTHING, TURNS, RIGHTS, FORWARDS = 0, 1, 2, 3
"""Tables of the graph that remember what lies between nodes."""


@njit(cache=True, nogil=True)
def flood(
    graph: Any, starts: Any, start_costs: Any, arcs: Any, reverse: bool, turn_cost: float,
    grid: Any, ground: Any,
) -> int:  # fmt: skip
    """Find the best way to every node that can be reached (Dijkstra, Dial's buckets).

    An entry of a bucket is a node and the entry below it. One whose node has become cheaper since
    stays and is passed over.

    Args:
        graph: a `DriveGraph`; its costs and origins are filled.
        starts: nodes where ways begin, flat indices, shape (S,).
        start_costs: cost of being there, increasing, shape (S,), int.
        arcs: displacements of turns, `IN_PLACE` or of `arc_moves`.
        reverse: whether driving backwards is allowed.
        turn_cost: of a turn, in cells per radian.
        grid: x, y of the corner of cell (0, 0) and edge of a cell [m, map], step of a turn [rad].
        ground: a `Ground`.

    Returns:
        Number of nodes reached.
    """
    costs, origins = graph.costs.ravel(), graph.origins.ravel()
    costs[:], origins[:] = -1, -1
    nx, ny = graph.costs.shape[0], graph.costs.shape[1]
    nodes, lefts, rights, forwards = graph.nodes, graph.turns, graph.rights, graph.moves
    in_place, (turns, moves) = not np.any(arcs), _prices(turn_cost, arcs)
    edges = (4 if in_place else 6) if reverse else 3
    ring = max(turns.max(), moves.max()) + 1
    bucket, entries = np.full(ring, -1, np.int64), np.empty((len(starts) + 1024, 2), np.int64)
    count, waiting, reached, cost, begun = 0, 0, 0, 0, 0
    while waiting or begun < len(starts):
        while begun < len(starts) and start_costs[begun] < cost + ring:
            node, total, begun = starts[begun], start_costs[begun], begun + 1
            if count == len(entries):
                entries = _doubled(entries)
            if costs[node] < 0 or total < costs[node]:
                costs[node], origins[node], waiting = total, node, waiting + 1
                count = _enter(entries, bucket, count, node, total % ring)
        entry = bucket[cost % ring]
        if entry < 0:
            cost += 1
            continue
        node, bucket[cost % ring], waiting = entries[entry, 0], entries[entry, 1], waiting - 1
        if costs[node] != cost:
            continue
        reached += 1
        if count + 6 > len(entries):
            entries = _doubled(entries)
        i, j, h = node // (ny * 16), node // 16 % ny, node % 16
        for edge in range(edges):
            a, b, g = _neighbor(arcs, i, j, h, edge)
            if not (0 <= a < nx and 0 <= b < ny):
                continue
            other = (a * ny + b) * 16 + g
            total = cost + (moves[h] if 2 <= edge < 4 else turns[edge % 2, h if edge < 2 else g])
            if 0 <= costs[other] <= total:
                continue
            state = nodes[a, b, g]
            state = ask_node(nodes, a, b, g, grid, ground) if state == UNASKED else state
            if state == BLOCKED:
                continue
            table, k, m, n = _between(in_place, (i, j, h), (a, b, g), edge)
            if table != NOTHING:
                state = (lefts if table == TURNS else rights if table == RIGHTS else forwards)[
                    k, m, n
                ]
            if state == UNASKED:
                state = _ask(graph, table, k, m, n, arcs, grid, ground)
            if state == BLOCKED:
                continue
            costs[other], origins[other], waiting = total, node, waiting + 1
            count = _enter(entries, bucket, count, other, total % ring)
    return reached


@njit(cache=True, nogil=True)
def _prices(turn_cost: float, arcs: Any) -> Any:
    """Costs of turns to the left and right from each heading, and of moves forwards."""
    turns, moves = np.empty((2, 16), np.int64), np.empty(16, np.int64)
    for h in range(16):
        for side in range(2):
            g = (h + 1) % 16 if side == 0 else (h + 15) % 16
            angle = turn_cost * abs(wrapped(HEADINGS[g] - HEADINGS[h]))
            length = math.hypot(arcs[side, h, 0], arcs[side, h, 1])
            turns[side, h] = max(1, round(UNITS * (angle + length)))
        moves[h] = round(UNITS * math.hypot(MOVES[h, 0], MOVES[h, 1]))
    return turns, moves


@njit(cache=True, nogil=True)
def _neighbor(arcs: Any, i: int, j: int, h: int, edge: int) -> tuple[int, int, int]:
    """Node at the other end of an edge.

    Edges 0, 1 turn left, right (forwards, if on an arc); 2, 3 drive forwards, backwards; 4, 5 go
    back to where a turn to the left, right leads from.
    """
    if edge < 2:
        g = (h + 1) % 16 if edge == 0 else (h + 15) % 16
        return i + arcs[edge, h, 0], j + arcs[edge, h, 1], g
    if edge < 4:
        dx, dy = MOVES[h, 0], MOVES[h, 1]
        return (i + dx, j + dy, h) if edge == 2 else (i - dx, j - dy, h)
    g = (h + 15) % 16 if edge == 4 else (h + 1) % 16
    return i - arcs[edge - 4, g, 0], j - arcs[edge - 4, g, 1], g


@njit(cache=True, nogil=True)
def _between(in_place: bool, node: Any, other: Any, edge: int) -> tuple[int, int, int, int]:
    """Where the graph remembers what lies between two nodes: table and index."""
    if 2 <= edge < 4:
        i, j, h = node if edge == 2 else other
        return FORWARDS if abs(MOVES[h, 0]) + abs(MOVES[h, 1]) > 1 else NOTHING, i, j, h
    if in_place:
        i, j, h = node if edge == 0 else other
        return TURNS, i, j, h
    i, j, h = node if edge < 2 else other
    return TURNS if edge % 2 == 0 else RIGHTS, i, j, h


@njit(cache=True, nogil=True)
def _ask(graph: Any, table: int, i: int, j: int, h: int, arcs: Any, grid: Any, ground: Any) -> Any:
    """State of an entry of a table that was not asked yet."""
    if table == FORWARDS:
        return ask_move(graph.moves, i, j, h, grid, ground)
    side = 0 if table == TURNS else 1
    turns = graph.turns if side == 0 else graph.rights
    dx, dy = arcs[side, h, 0], arcs[side, h, 1]
    return ask_turn(turns, i, j, h, 1 - 2 * side, dx, dy, grid, ground)


@njit(cache=True, nogil=True)
def _enter(entries: Any, bucket: Any, count: int, node: int, slot: int) -> int:
    """Put a node on top of a bucket; the new number of entries."""
    entries[count, 0], entries[count, 1] = node, bucket[slot]
    bucket[slot] = count
    return count + 1


@njit(cache=True, nogil=True)
def _doubled(entries: Any) -> Any:
    larger = np.empty((2 * len(entries), 2), np.int64)
    larger[: len(entries)] = entries
    return larger
