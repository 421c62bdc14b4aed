"""All ground that can be reached from one place, and the ways there."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.motion import drive_graph, drive_shortcut
from infomap_ros.motion.drive_graph import HEADINGS
from infomap_ros.motion.drive_space import DriveSpace

_ATTACH = 1  # cells around a place by which it joins the graph
_SAME_PLACE = 1e-6  # [m and rad]

NodeArray = NDArray[np.int64]


class DriveReach:
    """The graph of `drive_graph` searched from one start.

    Args:
        space: where the vehicle can stand.
        start: x, y, yaw, shape (3,). A robot that stands where it should not may leave from
            there over the configured distance.

    Only the last one made of a space holds: the next search overwrites it.
    """

    def __init__(self, space: DriveSpace, start: FloatArray) -> None:
        self._space, self.start, self._graph = space, start.copy(), space.graph
        nodes = self._joins(start, True)
        if not len(nodes) and not space.stands(start):
            nodes = self._escapes(start)
        ways = [np.stack([start, self._place_of(node)]) for node in nodes]
        costs = np.array([self._units(way) for way in ways], np.int64)
        config, order = space.config, np.argsort(costs, kind="stable")
        self.nodes_reached = drive_graph.flood(
            self._graph, nodes[order], costs[order], config.reverse,
            config.turn_cost / space.grid[2], space.grid, space.ground,
        )  # fmt: skip

    def starts_at(self, start: FloatArray) -> bool:
        """Whether this is what can be reached from there."""
        return bool(np.abs(self.start - start).max() < _SAME_PLACE)

    def cells(self) -> NDArray[np.bool_]:
        """Cells that are reached in any heading, shape (nx, ny)."""
        return np.asarray((self._graph.costs >= 0).any(axis=2))

    def way_to_any(self, places: FloatArray) -> tuple[FloatArray, int] | None:
        """The cheapest way to one of several places, shape (P, 3), and which it is; or None."""
        costs = self._graph.costs.ravel()
        best: tuple[int, int, int] | None = None
        for index, place in enumerate(places):
            for node in self._joins(place, False):
                total = int(costs[node]) + self._units(np.stack([self._place_of(node), place]))
                if best is None or total < best[0]:
                    best = total, int(node), index
        if best is None:
            return None
        return np.concatenate([self._way_to(best[1]), places[best[2]][None]]), best[2]

    def nearest_to(self, goals: FloatArray) -> tuple[FloatArray, int, float] | None:
        """Way to the reached node nearest to a goal, that goal, and the distance left [m]."""
        nodes = np.flatnonzero(self._graph.costs.ravel() >= 0)
        if not len(nodes):
            return None
        cells = np.column_stack(np.divmod(nodes // 16, self._graph.costs.shape[1]))
        middles = self._space.terrain.centres_of(cells)
        best = (np.inf, np.inf, 0, 0)
        for index, goal in enumerate(goals):
            left = np.hypot(*(middles - goal[:2]).T)
            nearest = left <= left.min() + 1e-9
            costs = np.where(nearest, self._graph.costs.ravel()[nodes], np.inf)
            found = int(costs.argmin())
            best = min(best, (float(left[found]), float(costs[found]), index, int(nodes[found])))
        return self._way_to(best[3]), best[2], best[0]

    def _way_to(self, node: int) -> FloatArray:
        """Places from the start to a node."""
        origins = self._graph.origins.ravel()
        way = [self._place_of(node)]
        while origins[node] != node:
            node = int(origins[node])
            way.append(self._place_of(node))
        return np.array([*way, self.start])[::-1].copy()

    def _joins(self, place: FloatArray, leave: bool) -> NodeArray:
        """Nodes near a place to which (or from which, if reached) the robot may drive."""
        nodes = []
        for node in self._nodes_around(place, _ATTACH):
            if not leave and self._graph.costs.ravel()[node] < 0:
                continue
            way = np.stack([place, self._place_of(node)])
            if self._space.fault_on(way if leave else way[::-1].copy()) is None:
                nodes.append(node)
        return np.array(nodes, np.int64)

    def _escapes(self, start: FloatArray) -> NodeArray:
        """Nodes near the start at which the robot may stand."""
        space, distance = self._space, self._space.config.escape
        nodes = self._nodes_around(start, int(np.ceil(distance / space.grid[2])))
        places = np.array([self._place_of(node) for node in nodes]).reshape(-1, 3)
        near = np.hypot(*(places[:, :2] - start[:2]).T) <= distance
        near[near] = space.vehicle.stances(space.terrain, places[near]).ok
        return np.asarray(nodes[near])

    def _units(self, way: FloatArray) -> int:
        config = self._space.config
        cost = drive_shortcut.drive_cost(way[0], way[1], config.reverse, config.turn_cost)
        return round(drive_graph.UNITS * cost / self._space.grid[2])

    def _nodes_around(self, place: FloatArray, reach: int) -> NodeArray:
        nx, ny, headings = self._graph.costs.shape
        middle, offsets = self._space.terrain.cells_of(place), np.arange(-reach, reach + 1)
        i, j, h = np.meshgrid(
            middle[0] + offsets, middle[1] + offsets, np.arange(headings), indexing="ij"
        )
        inside = (i >= 0) & (i < nx) & (j >= 0) & (j < ny)
        return np.asarray(((i * ny + j) * headings + h)[inside])

    def _place_of(self, node: int) -> FloatArray:
        """x, y, yaw of a node, shape (3,)."""
        cell, heading = divmod(int(node), len(HEADINGS))
        x, y = self._space.terrain.centres_of(divmod(cell, self._graph.costs.shape[1]))
        return np.array([x, y, HEADINGS[heading]])
