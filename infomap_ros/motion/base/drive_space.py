"""Where a vehicle can stand and drive on a terrain, found out as it is asked, and its motions."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray
from ompl import base as ob

from infomap_ros.geometry.config import check_config, parameter, setting
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.mapping.terrain.terrain import Terrain
from infomap_ros.motion.base import drive_graph
from infomap_ros.motion.base.drive_graph import (
    HEADINGS,
    IN_PLACE,
    arc_moves,
    arc_points,
    drive_cost,
    empty_graph,
)
from infomap_ros.motion.base.stance import Ground
from infomap_ros.motion.base.vehicle import Vehicle, terrain_arrays


@dataclass(frozen=True)
class BasePlannerConfig:
    """How a path of the base is looked for.

    Raises:
        ConfigError: a value is out of its range.
    """

    reverse: bool = parameter(True, "Whether the robot may drive backwards.")
    turning_radius: float = parameter(
        0.0, "Smallest radius on which the robot turns; 0 if it turns in place.", unit="m", low=0.0,
        high=50.0,
    )  # fmt: skip
    turn_cost: float = setting(
        0.2, "Length that a turn by one radian counts as.", unit="m/rad", low=0.0, high=0.35
    )
    standing_reach: ClassVar[float] = 0.2
    """Ground within this of the body counts as known because the robot stands there [m]."""

    def __post_init__(self) -> None:
        check_config(self)


@dataclass(frozen=True, eq=False)
class BasePath:
    """A path of the base: turns in place and straight lines, forwards or backwards.

    Attributes:
        poses: x, y [m] and yaw [rad] in the map, shape (K, 3), never more than a cell of the
            terrain or `TURN_STEP` apart, yaw continuous; empty where the robot
            cannot move at all.
        T_map_base: how it stands at each, shape (K, 4, 4).
        length: [m].
        complete: whether it leads to a goal; else it is the farthest safe approach.
        reason: why it is not complete, in words; empty where it is.
        goal: index of the goal that it leads or comes nearest to; -1 for none.
        method: what found it: ompl, lattice, or nothing.
    """

    poses: FloatArray
    T_map_base: FloatArray
    length: float
    complete: bool
    reason: str
    goal: int
    method: str

    @property
    def turning(self) -> float:
        """Sum of all turns [rad]."""
        return float(np.abs(np.diff(self.poses[:, 2])).sum()) if len(self.poses) else 0.0


_IN_PLACE = 1e-3  # [m]; radius at which the curves of Reeds and Shepp are turns in place


class Turns:
    """A vehicle that turns in place: turn, drive straight, turn.

    Attributes:
        reach: distance of nodes by which a place joins the graph [m].
    """

    def __init__(self, config: BasePlannerConfig, edge: float) -> None:
        self._config = config
        self.reach = edge

    def cost(self, a: FloatArray, b: FloatArray) -> float:
        """Cost of the path from a to b, shape (3,) each [m]."""
        return float(drive_cost(a, b, self._config.reverse, self._config.turn_cost))

    def join(self, a: FloatArray, b: FloatArray) -> FloatArray:
        """The path from a to b, both included, shape (K, 3)."""
        return np.stack([a, b])

    def chain(self, places: FloatArray) -> FloatArray:
        """The path through nodes that follow each other in the graph, shape (N, 3) -> (K, 3)."""
        return places

    def state_space(self) -> Any:
        """OMPL's space of these paths, without bounds: curves whose radius vanishes."""
        return _curves(_IN_PLACE, self._config.reverse)


class Curves:
    """A vehicle with a smallest radius: the curves of Reeds and Shepp, or of Dubins forwards.

    https://doi.org/10.2140/pjm.1990.145.367, https://doi.org/10.2307/2372560
    """

    def __init__(self, config: BasePlannerConfig, edge: float) -> None:
        self._spacing, self._turn_cost = edge, config.turn_cost / config.turning_radius
        self._radius, self._reverse = config.turning_radius, config.reverse
        self._space = self.state_space()
        bounds = ob.RealVectorBounds(2)
        bounds.setLow(-1e6)
        bounds.setHigh(1e6)
        self._space.setBounds(bounds)
        self.reach = 1.5 * config.turning_radius + edge

    def cost(self, a: FloatArray, b: FloatArray) -> float:
        """See `Turns`; as if all of it were curved."""
        distance = float(self._space.distance(self._state(a), self._state(b)))
        return distance * (1.0 + self._turn_cost)

    def join(self, a: FloatArray, b: FloatArray) -> FloatArray:
        """See `Turns`."""
        first, last, between = self._state(a), self._state(b), self._space.allocState()
        count = max(1, math.ceil(self._space.distance(first, last) / self._spacing))
        path = np.empty((count + 1, 3))
        for n in range(count + 1):
            self._space.interpolate(first, last, n / count, between)
            path[n] = between.getX(), between.getY(), between.getYaw()
        return path

    def chain(self, places: FloatArray) -> FloatArray:
        """See `Turns`."""
        parts = [arc_points(a, b, self._spacing)[1:] for a, b in pairwise(places)]
        return np.concatenate([places[:1], *parts])

    def state_space(self) -> Any:
        """See `Turns`."""
        return _curves(self._radius, self._reverse)

    def _state(self, place: FloatArray) -> Any:
        return state_of(self._space, place)


def _curves(radius: float, reverse: bool) -> Any:
    """OMPL's space of the shortest curves of a radius [m]."""
    return (ob.ReedsSheppStateSpace if reverse else ob.DubinsStateSpace)(radius)


def state_of(space: Any, place: FloatArray) -> Any:
    """OMPL's state of x, y, yaw, shape (3,), in a space."""
    state = space.allocState()
    state.setXY(float(place[0]), float(place[1]))
    state.setYaw(float((place[2] + np.pi) % (2.0 * np.pi) - np.pi))
    return state


Links = Turns | Curves
"""Paths between two places for one kind of vehicle."""


def links_for(config: BasePlannerConfig, edge: float) -> Links:
    """Links of the vehicle that a configuration describes, for cells of this edge [m]."""
    return Turns(config, edge) if config.turning_radius == 0.0 else Curves(config, edge)


TURN_LENGTH = 0.2
"""What a turn counts beside a length [m/rad]."""

TURN_STEP = 2.0 * np.pi / 32.0
"""No turn goes farther without a stance being asked [rad]: half the step of the lattice."""


class DriveSpace:
    """Memory of one terrain and one vehicle.

    Args:
        terrain: the ground.
        vehicle: the robot.
        config: of the planner.
    """

    def __init__(self, terrain: Terrain, vehicle: Vehicle, config: BasePlannerConfig) -> None:
        self.terrain, self.vehicle, self.config = terrain, vehicle, config
        self.grid = np.array([*terrain.origin, terrain.resolution, TURN_STEP])
        arrays = terrain_arrays(terrain, vehicle.config)
        self.ground = Ground.of(arrays, vehicle.arrays)
        in_place = config.turning_radius == 0.0
        self.arcs = IN_PLACE if in_place else arc_moves(config.turning_radius / self.grid[2])
        self.graph = empty_graph(terrain.heights.shape, in_place)

    def without_margin(self) -> DriveSpace:
        """The same ground for the vehicle as it is, kept from nothing by a margin."""
        return DriveSpace(self.terrain, self.vehicle.without_margin, self.config)

    def stands(self, place: FloatArray) -> bool:
        """Whether the robot may stand at x, y, yaw."""
        return self.fault_on(place[None]) is None

    def fault_on(self, places: FloatArray, steps: int = 1) -> FloatArray | None:
        """Place of the first stance on a path that is not good, shape (3,); None if all are.

        Args:
            places: the path, shape (K, 3).
            steps: stances to a cell's length, and to a step of the headings.
        """
        fault, spacing, angle = np.empty(3), self.grid[2] / steps, self.grid[3] / steps
        good = drive_graph.drives_well(
            places, self.config.reverse, spacing, angle, self.ground, fault
        )
        return None if good else fault

    def standable_goals(self, goals: FloatArray) -> tuple[FloatArray, NDArray[np.int64], list[str]]:
        """Goals at which the robot may stand, NaN headings replaced by each heading that is good.

        Returns:
            Places, shape (P, 3); the goal that each stands for, shape (P,); and per goal why it
            has none, empty where it has.
        """
        rows, owners = [], []
        for index, (x, y, yaw) in enumerate(goals):
            headings = HEADINGS if np.isnan(yaw) else np.array([yaw])
            rows.append(np.column_stack([np.full((len(headings), 2), (x, y)), headings]))
            owners += [index] * len(headings)
        places, owner = np.concatenate(rows), np.array(owners)
        good = self.vehicle.stances(self.terrain, places).ok
        reasons = []
        for index in range(len(goals)):
            own = np.flatnonzero(owner == index)
            bad = "" if good[own].any() else self.vehicle.refusal(self.terrain, places[own[0]])
            reasons.append(bad and f"goal: {bad}")
        return places[good], owner[good], reasons

    def in_steps(self, path: FloatArray) -> FloatArray:
        """A path in the steps in which it is asked and driven, shape (K, 3) -> (N, 3)."""
        config, poses = self.config, np.array(path)
        if config.turning_radius == 0.0:
            poses = drive_graph.points_along(poses, config.reverse, self.grid[2], self.grid[3])
        return poses

    def finished(self, path: FloatArray, goal: int, method: str, reason: str = "") -> BasePath:
        """Path as the caller gets it: in the steps in which it was asked, each with its stance."""
        poses = self.in_steps(path)
        poses[:, 2] = np.unwrap(poses[:, 2])
        length = float(np.hypot(*np.diff(path[:, :2], axis=0).T).sum())
        stances = standing_on(poses, self.vehicle.stances(self.terrain, poses).T_map_base)
        return BasePath(poses, stances, length, not reason, reason, goal, method)

    def nowhere(self, reason: str) -> BasePath:
        """No path at all."""
        return BasePath(np.zeros((0, 3)), np.zeros((0, 4, 4)), 0.0, False, reason, -1, "nothing")


def apart(places: FloatArray, place: FloatArray) -> FloatArray:
    """How far places x, y, yaw, shape (K, 3), are from one, shape (3,) [m], turns as lengths."""
    turns = np.abs((places[:, 2] - place[2] + np.pi) % (2.0 * np.pi) - np.pi)
    away = np.hypot(places[:, 0] - place[0], places[:, 1] - place[1])
    return np.asarray(away + TURN_LENGTH * turns)


def standing_on(poses: FloatArray, stances: FloatArray) -> FloatArray:
    """Stances with those that are not known taken from their nearest neighbors on the path.

    A robot that leaves a place where it should not stand may come by ground that the map does not
    know. Where no stance is known the ground counts as level, at height zero.

    Args:
        poses: x, y [m] and yaw [rad], shape (K, 3).
        stances: ``T_map_base`` of each, shape (K, 4, 4); NaN where there is none.
    """
    known = np.flatnonzero(np.isfinite(stances).all(axis=(1, 2)))
    planar = _planar(poses)
    if len(known) == len(poses) or not len(known):
        return stances if len(known) else planar
    nearest = known[np.abs(np.arange(len(poses))[:, None] - known).argmin(axis=1)]
    moved = planar @ np.linalg.inv(planar[nearest]) @ stances[nearest]
    moved[known] = stances[known]
    return moved


def _planar(poses: FloatArray) -> FloatArray:
    """Level transforms at height zero, shape (K, 3) -> (K, 4, 4)."""
    transforms = np.tile(np.eye(4), (len(poses), 1, 1))
    cos, sin = np.cos(poses[:, 2]), np.sin(poses[:, 2])
    transforms[:, 0, 0], transforms[:, 0, 1] = cos, -sin
    transforms[:, 1, 0], transforms[:, 1, 1] = sin, cos
    transforms[:, :2, 3] = poses[:, :2]
    return transforms
