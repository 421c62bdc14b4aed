"""Driving from place to place, and the complete search over a lattice of places: compiled kernels.

A robot turns, drives straight and turns, or it goes on arcs where it cannot turn in place: then two
places of different heading are linked by a straight line, an arc and a straight line, one of the
lines of length zero, the arc tangent to the lines on which the headings lie.

The lattice is one of cells and headings (x, y, heading). 16 headings point exactly at neighboring
cells, up to a knight's move away, so that every path in the graph can be driven as it is: one move
forwards or backwards, or a turn to the next heading, in place or on an arc that leads to another
cell's middle. Stances in between are asked too, one per edge of a cell and per step of a turn.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

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
    """First turn [rad], length [m] and last turn [rad] of the path from a to b.

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
    """Place after a number of steps of the path from a to b."""
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
    """Drive through places, shape (K, 3), and ask every stance on the path itself.

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


@njit(cache=True, nogil=True)
def drive_cost(a: Any, b: Any, reverse: bool, turn_cost: float) -> float:
    """Length of the path from a to b [m], its turns counted at `turn_cost` [m/rad]."""
    first, length, last = legs_of(a[0], a[1], a[2], b[0], b[1], b[2], reverse)
    return length + turn_cost * (abs(first) + abs(last))


@njit(cache=True, nogil=True)
def points_along(places: Any, reverse: bool, spacing: float, angle: float) -> Any:
    """Path through places, shape (K, 3), in steps of at most `spacing` [m] and `angle` [rad]."""
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


@njit(cache=True, nogil=True)
def arc_between(a: Any, b: Any) -> Any:
    """Line before, turn, radius, line after from a to b; lengths negative backwards [m, rad].

    The radius is 0 where the places are on one line, NaN where no such path links them.
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
    """The path from a to b in equal steps of at most `spacing` [m], both included, shape (n, 3)."""
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
        costs: of the best path from the start, in units of 1/20 cell; -1 = not reached.
        origins: node from which a node is reached; itself for a node where paths begin.
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


NOTHING, TURNS, RIGHTS, FORWARDS = 0, 1, 2, 3
"""Tables of the graph that remember what lies between nodes."""


@njit(cache=True, nogil=True)
def flood(
    graph: Any, starts: Any, start_costs: Any, arcs: Any, reverse: bool, turn_cost: float,
    grid: Any, ground: Any,
) -> int:  # fmt: skip
    """Find the best path to every node that can be reached (Dijkstra, Dial's buckets).

    An entry of a bucket is a node and the entry below it. One whose node has become cheaper since
    stays and is passed over.

    Args:
        graph: a `DriveGraph`; its costs and origins are filled.
        starts: nodes where paths begin, flat indices, shape (S,).
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
