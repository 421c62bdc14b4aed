"""All ground that can be reached from one place, and the ways there."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.motion.base import drive_flood, drive_graph
from infomap_ros.motion.base.drive_graph import HEADINGS
from infomap_ros.motion.base.drive_links import links_for
from infomap_ros.motion.base.drive_space import DriveSpace

_MOST_BESIDE = 4  # cells to each side of a place that are tried; of more every second, third, ...
_WITHDRAWAL = 0.1  # [m]; by which it drives straight before it asks again where it can turn
_SAME_PLACE = 1e-6  # [m and rad]

NodeArray = NDArray[np.int64]


class DriveReach:
    """The graph of `drive_graph` searched from one start.

    Args:
        space: where the vehicle can stand.
        start: x, y, yaw, shape (3,). A robot that stands where it should not may leave from
            there over the configured distance; one that is only nearer to things than its margin
            touches nothing on that way if that can be avoided.

    Only the last one made of a space holds: the next search overwrites it.
    """

    def __init__(self, space: DriveSpace, start: FloatArray) -> None:
        self._space, self.start, self._graph = space, start.copy(), space.graph
        self._links = links_for(space.config, float(space.grid[2]))
        self._entry = start.copy()
        nodes = self._joins(start)
        if not len(nodes):
            nodes = self._withdrawn(start, space) if space.stands(start) else self._left(start)
        costs = self._costs([(self._entry, self._place_of(node)) for node in nodes])
        config, order = space.config, np.argsort(costs, kind="stable")
        self.nodes_reached = drive_flood.flood(
            self._graph, nodes[order], costs[order], space.arcs, config.reverse,
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
        ends = [
            (int(node), index)
            for index, place in enumerate(places)
            for node in self._nodes_around(place)
            if costs[node] >= 0
        ]
        last = self._costs([(self._place_of(node), places[index]) for node, index in ends])
        totals = [int(costs[node]) + int(cost) for (node, _), cost in zip(ends, last, strict=True)]
        for n in np.argsort(totals, kind="stable"):
            node, index = ends[n]
            join = self._links.join(self._place_of(node), places[index])
            if self._space.fault_on(join) is None:
                return np.concatenate([self._way_to(node), join[1:]]), index
        return None

    def nearest_to(self, goals: FloatArray) -> tuple[FloatArray, int, float] | None:
        """Way to the reached node nearest to a goal, that goal, and the distance left [m]."""
        nodes = np.flatnonzero(self._graph.costs.ravel() >= 0)
        if not len(nodes):
            return None
        cells = np.column_stack(np.divmod(nodes // 16, self._graph.costs.shape[1]))
        middles = self._space.terrain.centers_of(cells)
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
        first = self._links.join(self._entry, way[-1])
        if np.abs(self._entry - self.start).max() > _SAME_PLACE:
            first = np.concatenate([self.start[None], first])
        return np.concatenate([first[:-1], self._links.chain(np.array(way[::-1]))])

    def _joins(self, place: FloatArray) -> NodeArray:
        """Nodes near a place to which the robot may drive."""
        nodes = [
            node
            for node in self._nodes_around(place)
            if self._space.fault_on(self._links.join(place, self._place_of(node))) is None
        ]
        return np.array(nodes, np.int64)

    def _left(self, start: FloatArray) -> NodeArray:
        """Nodes to which the robot may leave a start in which it should not stand."""
        nodes, bare = self._escapes(start), self._space.without_margin()
        if not bare.stands(start):
            return nodes
        joins = (self._links.join(start, self._place_of(node)) for node in nodes)
        free = np.array([bare.fault_on(join) is None for join in joins], np.bool_)
        if free.any():
            return np.asarray(nodes[free])
        withdrawn = self._withdrawn(start, bare)
        return withdrawn if len(withdrawn) else nodes

    def _withdrawn(self, start: FloatArray, space: DriveSpace) -> NodeArray:
        """Nodes near a place straight behind or before a start in which the robot cannot turn."""
        ahead = np.array([np.cos(start[2]), np.sin(start[2]), 0.0])
        signs = (-1.0, 1.0) if space.config.reverse else (1.0,)
        for distance in np.arange(_WITHDRAWAL, space.config.reach + 1e-9, _WITHDRAWAL):
            for sign in signs:
                place = start + sign * distance * ahead
                if space.fault_on(np.stack([start, place])) is None:
                    nodes = self._joins(place)
                    if len(nodes):
                        self._entry = place
                        return nodes
        return np.zeros(0, np.int64)

    def _escapes(self, start: FloatArray) -> NodeArray:
        """Nodes near the start at which the robot may stand."""
        space, distance = self._space, self._space.config.escape
        nodes = self._nodes_around(start, distance)
        places = np.array([self._place_of(node) for node in nodes]).reshape(-1, 3)
        near = np.hypot(*(places[:, :2] - start[:2]).T) <= distance
        near[near] = space.vehicle.stances(space.terrain, places[near]).ok
        return np.asarray(nodes[near])

    def _costs(self, ways: list[tuple[FloatArray, FloatArray]]) -> NodeArray:
        """Costs of ways from one place to another, in the graph's units."""
        scale = drive_graph.UNITS / self._space.grid[2]
        return np.array([round(scale * self._links.cost(*way)) for way in ways], np.int64)

    def _nodes_around(self, place: FloatArray, reach: float | None = None) -> NodeArray:
        """Nodes within a distance of a place along x and y, the links' reach if none is given."""
        nx, ny, headings = self._graph.costs.shape
        cells = int(np.ceil((self._links.reach if reach is None else reach) / self._space.grid[2]))
        stride = max(1, cells // _MOST_BESIDE)
        middle, offsets = self._space.terrain.cells_of(place), np.arange(-cells, cells + 1, stride)
        i, j, h = np.meshgrid(
            middle[0] + offsets, middle[1] + offsets, np.arange(headings), indexing="ij"
        )
        inside = (i >= 0) & (i < nx) & (j >= 0) & (j < ny)
        return np.asarray(((i * ny + j) * headings + h)[inside])

    def _place_of(self, node: int) -> FloatArray:
        """x, y, yaw of a node, shape (3,)."""
        cell, heading = divmod(int(node), len(HEADINGS))
        x, y = self._space.terrain.centers_of(divmod(cell, self._graph.costs.shape[1]))
        return np.array([x, y, HEADINGS[heading]])
