"""Paths of the base over rough ground, all ground that it can reach, and why it gets nowhere."""

from __future__ import annotations

import dataclasses
import math
from collections import Counter

import numpy as np
from numpy.typing import ArrayLike, NDArray

from infomap_ros.errors import InvalidInputError
from infomap_ros.geometry import float_array
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.mapping.terrain.terrain import Terrain
from infomap_ros.motion.base import drive_graph
from infomap_ros.motion.base.drive_graph import HEADINGS, legs_of
from infomap_ros.motion.base.drive_space import BasePath, BasePlannerConfig, DriveSpace, links_for
from infomap_ros.motion.base.driven_path import REACH, DrivenPath
from infomap_ros.motion.base.standing_ground import with_standing_ground
from infomap_ros.motion.base.vehicle import Vehicle

_MOST_BESIDE = 4  # cells to each side of a place that are tried; of more every second, third, ...
_WITHDRAWAL = 0.1  # [m]; by which it drives straight before it asks again where it can turn
_SAME_PLACE = 1e-6  # [m and rad]
_SAMPLES = 2000  # random places that OMPL tries for a path better than the lattice's
_ESCAPE = 0.25  # over which a robot may leave that stands where it should not [m]

NodeArray = NDArray[np.int64]


class DriveReach:
    """The graph of `drive_graph` searched from one start.

    Args:
        space: where the vehicle can stand.
        start: x, y, yaw, shape (3,). A robot that stands where it should not may leave from
            there over the configured distance; one that is only nearer to things than its margin
            touches nothing on that path if that can be avoided.

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
        drive_graph.flood(
            self._graph, nodes[order], costs[order], space.arcs, config.reverse,
            config.turn_cost / space.grid[2], space.grid, space.ground,
        )  # fmt: skip

    def starts_at(self, start: FloatArray) -> bool:
        """Whether this is what can be reached from there."""
        return bool(np.abs(self.start - start).max() < _SAME_PLACE)

    def cells(self) -> NDArray[np.bool_]:
        """Cells that are reached in any heading, shape (nx, ny)."""
        return np.asarray((self._graph.costs >= 0).any(axis=2))

    def path_to_any(self, places: FloatArray) -> tuple[FloatArray, int] | None:
        """The cheapest path to one of several places, shape (P, 3), and which it is; or None."""
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
                return np.concatenate([self._path_to(node), join[1:]]), index
        return None

    def nearest_to(self, goals: FloatArray) -> tuple[FloatArray, int, float] | None:
        """Path to the reached node nearest to a goal, that goal, and the distance left [m]."""
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
        return self._path_to(best[3]), best[2], best[0]

    def _path_to(self, node: int) -> FloatArray:
        """Places from the start to a node."""
        origins = self._graph.origins.ravel()
        places = [self._place_of(node)]
        while origins[node] != node:
            node = int(origins[node])
            places.append(self._place_of(node))
        first = self._links.join(self._entry, places[-1])
        if np.abs(self._entry - self.start).max() > _SAME_PLACE:
            first = np.concatenate([self.start[None], first])
        return np.concatenate([first[:-1], self._links.chain(np.array(places[::-1]))])

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
        for distance in np.arange(_WITHDRAWAL, REACH + 1e-9, _WITHDRAWAL):
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
        space, distance = self._space, _ESCAPE
        nodes = self._nodes_around(start, distance)
        places = np.array([self._place_of(node) for node in nodes]).reshape(-1, 3)
        near = np.hypot(*(places[:, :2] - start[:2]).T) <= distance
        near[near] = space.vehicle.stances(space.terrain, places[near]).ok
        return np.asarray(nodes[near])

    def _costs(self, motions: list[tuple[FloatArray, FloatArray]]) -> NodeArray:
        """Costs of motions from one place to another, in the graph's units."""
        scale = drive_graph.UNITS / self._space.grid[2]
        return np.array([round(scale * self._links.cost(*motion)) for motion in motions], np.int64)

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


class BasePlanner:
    """Plans for one terrain, one vehicle in one posture, and one place where it stands.

    What was found out about the ground is kept, so that many plans cost less than one each.

    Args:
        terrain: the ground as the map shows it.
        vehicle: the robot.
        config: None for the defaults.
        standing: T_map_base in which the robot stands, shape (4, 4): the ground there is known.
    """

    def __init__(
        self,
        terrain: Terrain,
        vehicle: Vehicle,
        config: BasePlannerConfig | None = None,
        standing: ArrayLike | None = None,
    ) -> None:
        self.config = config or BasePlannerConfig()
        self.vehicle = vehicle
        self._reach: DriveReach | None = None
        if standing is not None:
            reach = self.config.standing_reach
            terrain = with_standing_ground(terrain, vehicle, standing, reach)
        self._space: DriveSpace = DriveSpace(terrain, vehicle, self.config)

    @property
    def terrain(self) -> Terrain:
        """The ground, with that on which the robot stands."""
        return self._space.terrain

    def plan(self, start: ArrayLike, goals: ArrayLike, samples: int | None = None) -> BasePath:
        """Find a path to one of the goals, or as near to one as is safe.

        The lattice says which goal is nearest and how it is reached; OMPL plans the path there
        anew and shortens it (`driven_path`). The lattice's path is kept where OMPL finds none
        that costs less.

        Args:
            start: x, y [m] and yaw [rad] of the base in the map, shape (3,).
            goals: likewise, shape (3,) or (G, 3); yaw NaN for any heading.
            samples: random places that OMPL may try; None for the configuration's, 0 for the
                lattice's path as it is.

        Raises:
            InvalidInputError: shapes do not fit, or values are not finite.
        """
        here, targets = _places(start, "start", False)[0], _places(goals, "goals", True)
        places, owners, reasons = self._space.standable_goals(targets)
        found = self._reached_from(here).path_to_any(places)
        if found is None:
            return self._approach(targets, reasons, samples)
        path, method = self._driven(found[0], samples)
        goal = _owner(path[-1], places, owners)
        if np.isnan(targets[goal, 2]):
            path = self._free_arrival(path)
        return self._space.finished(path, goal, method)

    def reachable_area(self, start: ArrayLike) -> NDArray[np.bool_]:
        """Cells of the terrain in whose middle the base can stand and to which it can drive.

        Args:
            start: x, y, yaw of the base, shape (3,).

        Returns:
            Shape (nx, ny), indexed [x, y] as `terrain`.

        Raises:
            InvalidInputError: it is not finite.
        """
        return self._reached_from(_places(start, "start", False)[0]).cells()

    @property
    def _ompl(self) -> DrivenPath:
        return DrivenPath(self._space, links_for(self.config, float(self._space.grid[2])))

    def _reached_from(self, start: FloatArray) -> DriveReach:
        """All ground that can be reached from a start, remembered for the last one."""
        if self._reach is None or not self._reach.starts_at(start):
            self._reach = DriveReach(self._space, start)
        return self._reach

    def _driven(self, path: FloatArray, samples: int | None) -> tuple[FloatArray, str]:
        """OMPL's path or else the lattice's, and which it is."""
        most = _SAMPLES if samples is None else samples
        better = self._ompl.better_than(path, most) if most > 0 else None
        return (path, "lattice") if better is None else (better, "ompl")

    def _free_arrival(self, path: FloatArray) -> FloatArray:
        """A path to a goal of any heading without its last turn, where that may be left out."""
        if len(path) < 2 or self.config.turning_radius > 0.0:
            return path
        a, b = path[-2:]
        first, length, _ = legs_of(*a, *b, self.config.reverse)
        arrival = path.copy()
        arrival[-1, 2] = a[2] + first if length > 0.0 else a[2]
        return path if self._space.fault_on(arrival[-2:]) is not None else arrival

    def _approach(self, targets: FloatArray, reasons: list[str], samples: int | None) -> BasePath:
        """The farthest safe approach, or no path at all, and why."""
        assert self._reach is not None
        nearest = self._reach.nearest_to(targets)
        if nearest is None:
            reason = self._why_stuck(self._reach)
            return self._space.nowhere(f"the robot cannot leave its place: {reason}")
        path, goal, left = nearest
        reason = reasons[goal] or "no path to the goal over ground that is known and safe"
        reason += f"; the farthest safe approach ends {left:.2f} m from it"
        path, method = self._driven(path, samples)
        return self._space.finished(path, goal, method, reason)

    def _why_stuck(self, reach: DriveReach) -> str:
        reason = self.vehicle.refusal(self.terrain, reach.start)
        return reason or "no pose next to it is safe"


def _places(values: ArrayLike, name: str, any_heading: bool) -> FloatArray:
    rows = float_array(values, name)
    if rows.ndim == 1:
        rows = rows[None]
    if rows.ndim != 2 or rows.shape[1] != 3 or not len(rows):
        raise InvalidInputError(name, f"shape {rows.shape}, expected (3,) or (N, 3)")
    if not np.isfinite(rows[:, : 2 if any_heading else 3]).all() or np.isinf(rows).any():
        raise InvalidInputError(name, "hold NaN or infinity")
    return rows


def _owner(place: FloatArray, places: FloatArray, owners: NDArray[np.int64]) -> int:
    """Goal to which the place belongs at which a path ends."""
    away = np.hypot(*(places[:, :2] - place[:2]).T)
    away += np.abs((places[:, 2] - place[2] + math.pi) % (2.0 * math.pi) - math.pi)
    return int(owners[away.argmin()])


_CONFINED = 0.3  # [m]; a base that gets no farther does not drive
_HEADINGS = 8
_EDGE = "outside"  # of the terrain: a wide body comes there before it says why


def why_confined(planner: BasePlanner, here: FloatArray) -> str:
    """Why the base cannot leave the place where it stands, or empty where it can.

    Args:
        planner: of the base.
        here: x, y [m] and yaw [rad] of the base in the map, shape (3,).

    Returns:
        What is in the way where it stands, else what is most often in the way 0.3 m from there.
    """
    area, terrain = planner.reachable_area(here), planner.terrain
    cells = np.argwhere(area)
    away = np.hypot(*(terrain.centers_of(cells) - here[:2]).T) if len(cells) else np.zeros(1)
    if away.max() > _CONFINED:
        return ""
    reason = planner.vehicle.refusal(terrain, here)
    if len(cells):
        return (
            f"it gets {away.max():.1f} m from its place: {_around(planner.vehicle, terrain, here)}"
        )
    return reason or f"no pose next to it is safe: {_around(planner.vehicle, terrain, here)}"


def _around(vehicle: Vehicle, terrain: Terrain, here: FloatArray) -> str:
    """What most often speaks against poses beside a place, and turned at it."""
    bearings = here[2] + np.arange(_HEADINGS) * (2.0 * np.pi / _HEADINGS)
    poses = [np.array([*here[:2], bearing]) for bearing in bearings[1:]]
    for bearing in bearings:
        beside = here[:2] + _CONFINED * np.array([np.cos(bearing), np.sin(bearing)])
        poses += [np.array([*beside, here[2]]), np.array([*beside, bearing])]
    found = [reason for pose in poses if (reason := vehicle.refusal(terrain, pose))]
    if not found:
        return "no path was found between poses that are safe"
    relevant = [reason for reason in found if not reason.startswith(_EDGE)] or found
    kinds = Counter(reason.split(" at (")[0] for reason in relevant)
    kind, count = kinds.most_common(1)[0]
    example = next(reason for reason in relevant if reason.startswith(kind))
    return f"in {count} of {len(poses)} poses about it {example}"


_EXITS = 40  # nearest cells outside, of which the one with the cheapest path is taken


class LeavingPlanner(BasePlanner):
    """Plans for a robot that stands in a keep-out region or outside a fence.

    Paths begin with the shortest one to where it may stand; from there on they keep to the rules.
    Other regions and fences hold from the start.

    Args:
        terrain: the ground, with all that is closed.
        opened: the same without what the robot stands in.
        vehicle: the robot.
        config: of the planner.
        standing: T_map_base in which the robot stands, shape (4, 4).
    """

    def __init__(
        self,
        terrain: Terrain,
        opened: Terrain,
        vehicle: Vehicle,
        config: BasePlannerConfig,
        standing: ArrayLike | None = None,
    ) -> None:
        super().__init__(terrain, vehicle, config, standing)
        self._opened = BasePlanner(opened, vehicle, config, standing)
        self._out: tuple[FloatArray, BasePath] | None = None

    def plan(self, start: ArrayLike, goals: ArrayLike, samples: int | None = None) -> BasePath:
        """The path out and on to one of the goals, or as near to one as is safe; see `BasePlanner`.

        Where there is no path on, the path out alone, with the reason.
        """
        out = self._exit_path(np.asarray(start, dtype=np.float64))
        if not out.complete:
            return out
        on = super().plan(out.poses[-1], goals, samples)
        return _joined(out, on) if len(on.poses) else _alone(out, on)

    def reachable_area(self, start: ArrayLike) -> NDArray[np.bool_]:
        """Cells in which the base may stand and to which it can drive; see `BasePlanner`."""
        out = self._exit_path(np.asarray(start, dtype=np.float64))
        if not out.complete:
            return np.zeros(self.terrain.heights.shape, np.bool_)
        return super().reachable_area(out.poses[-1])

    def _exit_path(self, start: FloatArray) -> BasePath:
        """The shortest path to where the robot may stand, remembered for the last start."""
        if self._out is None or not np.array_equal(self._out[0], start):
            self._out = start.copy(), self._find_exit_path(start)
        return self._out[1]

    def _find_exit_path(self, start: FloatArray) -> BasePath:
        area = self._opened.reachable_area(start)
        cells = np.argwhere(area)
        middles = self._opened.terrain.centers_of(cells)
        order = np.argsort(np.hypot(*(middles - start[:2]).T), kind="stable")
        places = np.empty((len(order), len(HEADINGS), 3))
        places[:, :, :2], places[:, :, 2] = middles[order][:, None], HEADINGS
        good = self.vehicle.stances(self.terrain, places.reshape(-1, 3)).ok
        exits = places[good.reshape(places.shape[:2]).any(axis=1)][:_EXITS]
        goals = exits.reshape(-1, 3)
        goals = goals[self.vehicle.stances(self.terrain, goals).ok]
        where = self.vehicle.closed_at(self.terrain, *start)
        if not len(goals):
            reason = f"the robot stands {where}, and no path leads out"
            return self._space.nowhere(reason)
        path = self._opened.plan(start, goals, samples=0)
        if path.complete:
            return path
        return self._space.nowhere(f"the robot stands {where}: {path.reason}")


def _joined(first: BasePath, second: BasePath) -> BasePath:
    """One path after the other."""
    poses = np.concatenate([first.poses, second.poses[1:]])
    poses[:, 2] = np.unwrap(poses[:, 2])
    return dataclasses.replace(
        second,
        poses=poses,
        T_map_base=np.concatenate([first.T_map_base, second.T_map_base[1:]]),
        length=first.length + second.length,
    )


def _alone(out: BasePath, on: BasePath) -> BasePath:
    """The path out, which leads to no goal."""
    return dataclasses.replace(out, complete=False, reason=on.reason, goal=on.goal)
