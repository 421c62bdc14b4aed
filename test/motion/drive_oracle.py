"""Where the rover can drive, found slowly: every stance asked of `Vehicle`, a plain search."""

from __future__ import annotations

import heapq
import math

import numpy as np

from infomap_ros.mapping.terrain.terrain import Terrain
from infomap_ros.motion.base.vehicle import Vehicle

STEPS = [(1, 0), (2, 1), (1, 1), (1, 2), (0, 1), (-1, 2), (-1, 1), (-2, 1)]
STEPS += [(-a, -b) for a, b in STEPS]
HEADINGS = [math.atan2(b, a) for a, b in STEPS]

Node = tuple[int, int, int]


class DriveOracle:
    """The graph of cells (x, y, heading) of a terrain.

    Args:
        terrain: the ground.
        vehicle: the robot.
        turn_cost: of a turn [m/rad].
        reverse: whether it may drive backwards.
    """

    def __init__(
        self, terrain: Terrain, vehicle: Vehicle, turn_cost: float, reverse: bool = True
    ) -> None:
        self.terrain, self.turn_cost, self.reverse = terrain, turn_cost, reverse
        nx, ny = terrain.heights.shape
        nodes = np.array([(i, j, h) for i in range(nx) for j in range(ny) for h in range(16)])
        steps, headings = np.array(STEPS), np.array(HEADINGS)[nodes[:, 2]]
        turns = (np.array(HEADINGS)[(nodes[:, 2] + 1) % 16] - headings) % (2.0 * math.pi)

        def good(moved: np.ndarray, turned: np.ndarray, parts: np.ndarray, n: int) -> np.ndarray:
            """Stances at the n-th of so many parts of a move or turn; good beyond the last."""
            share = np.minimum(n / parts, 1.0)
            xy = terrain.centers_of(nodes[:, :2] + moved * share[:, None])
            places = np.column_stack([xy, headings + turned * share])
            return (vehicle.stances(terrain, places).ok | (n >= parts)).reshape(nx, ny, 16)

        no_move, no_turn, one = np.zeros((len(nodes), 2)), np.zeros(len(nodes)), np.ones(len(nodes))
        self.nodes = good(no_move, no_turn, 2.0 * one, 0)
        moved = steps[nodes[:, 2]].astype(float)
        lengths = np.ceil(np.hypot(*moved.T) - 1e-9)
        angles = np.ceil(turns / (2.0 * math.pi / 32.0) - 1e-9)
        self.turns = good(no_move, turns, angles, 1) & good(no_move, turns, angles, 2)
        self.moves = good(moved, no_turn, lengths, 1) & good(moved, no_turn, lengths, 2)

    def neighbors(self, node: Node) -> list[tuple[Node, float]]:
        """Nodes next to one, and the cost of going there [m]."""
        i, j, h = node
        found = []
        for g, between in (((h + 1) % 16, h), ((h - 1) % 16, (h - 1) % 16)):
            angle = abs((HEADINGS[g] - HEADINGS[h] + math.pi) % (2 * math.pi) - math.pi)
            if self.turns[i, j, between]:
                found.append(((i, j, g), self.turn_cost * angle))
        a, b = STEPS[h]
        length = math.hypot(a, b) * self.terrain.resolution
        if self.moves[i, j, h]:
            found.append(((i + a, j + b, h), length))
        if self.reverse and self.is_inside(i - a, j - b) and self.moves[i - a, j - b, h]:
            found.append(((i - a, j - b, h), length))
        return [(n, c) for n, c in found if self.is_inside(n[0], n[1]) and self.nodes[n]]

    def is_inside(self, i: int, j: int) -> bool:
        """Whether a cell lies on the grid."""
        return 0 <= i < self.nodes.shape[0] and 0 <= j < self.nodes.shape[1]

    def costs_from(self, start: Node) -> np.ndarray:
        """Cost of the best path to each node [m], inf where there is none (Dijkstra)."""
        costs = np.full(self.nodes.shape, np.inf)
        costs[start] = 0.0
        waiting = [(0.0, start)]
        while waiting:
            cost, node = heapq.heappop(waiting)
            if cost > costs[node]:
                continue
            for other, price in self.neighbors(node):
                if cost + price < costs[other] - 1e-12:
                    costs[other] = cost + price
                    heapq.heappush(waiting, (cost + price, other))
        return costs

    def place_of(self, node: Node) -> np.ndarray:
        """x, y, yaw of a node."""
        return np.array([*self.terrain.centers_of(node[:2]), HEADINGS[node[2]]])
