"""A path of the arm that touches nothing, from one configuration to another, and its times.

The straight line in joint space if that is free, else a path found by two random trees that grow
towards each other, then shortened: OMPL's RRT-Connect (Kuffner and LaValle 2000,
https://doi.org/10.1109/ROBOT.2000.844730) and PathSimplifier. All of a path is known to be free,
not only the configurations that were looked at (`kernels.first_on_segment`). The effort is a
number of samples: a clock would make a path depend on what else the machine does.

Times keep limits of velocity and acceleration. The joints move together along each straight piece
with the trapezoidal profile that is the fastest between the speeds at its ends: for a piece of unit
direction u the path speed is at most min v_j / |u_j| and its change at most min a_j / |u_j|. At a
corner they stop, or pass it on a parabola where a collision check finds that free.

Near a corner the path leaves its two straight pieces for a parabola, on which the velocity changes
evenly from along the one to along the other, as in Kunz and Stilman, "Time-optimal trajectory
generation for path following with bounded acceleration and velocity" (Robotics: Science and
Systems 2012, doi:10.15607/RSS.2012.VIII.027), who take circles. With the path speed v at both ends,
u and w the unit directions of the pieces, and m the largest component of |w - u|, a joint that may
accelerate by a needs the time v m / a for it. The parabola begins and ends

    h = v^2 m / (2 a)

from the corner, and passes it at v^2 m^2 / (8 a), by the joint that comes off most.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike
from ompl import base as ob
from ompl import geometric as og
from ompl import util

from infomap_ros.errors import InvalidInputError
from infomap_ros.geometry import float_array
from infomap_ros.geometry.config import check_config, parameter, setting
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.motion.collision.checker import CollisionChecker
from infomap_ros.motion.collision.kernels import first_on_segment
from infomap_ros.motion.robot.chain import KinematicChain
from infomap_ros.motion.route import ArmPath

FreeSegment = Callable[[FloatArray, FloatArray], bool]
"""Whether all of the segment between two configurations, shape (n,) each, is free."""

_HALF = 0.45  # of a piece that a parabola may take
_INSTANT = 1e-5  # [s]
_FEWEST = 5  # knots of a parabola


@dataclass(frozen=True, eq=False)
class StraightPieces:
    """A path of straight pieces with its limits.

    Attributes:
        corners: shape (K, n) [rad or m], no two after each other the same.
        speeds: largest path speed on each piece, shape (K - 1,) [1/s].
        growths: its largest change, shape (K - 1,) [1/s^2].
        acceleration: largest of each joint [rad/s^2 or m/s^2].
    """

    corners: FloatArray
    speeds: FloatArray
    growths: FloatArray
    acceleration: float

    @classmethod
    def of(cls, corners: FloatArray, velocities: FloatArray, acceleration: float) -> StraightPieces:
        """Limits along each piece from those of the joints, shape (n,)."""
        changes = np.diff(corners, axis=0)
        units = np.abs(changes) / np.linalg.norm(changes, axis=1, keepdims=True)
        with np.errstate(divide="ignore"):
            speeds = (velocities / units).min(axis=1, initial=np.inf)
            growths = (acceleration / units).min(axis=1, initial=np.inf)
        return cls(corners, speeds, growths, acceleration)

    @property
    def lengths(self) -> FloatArray:
        """Of the pieces, shape (K - 1,)."""
        return np.asarray(np.linalg.norm(np.diff(self.corners, axis=0), axis=1))

    @property
    def directions(self) -> FloatArray:
        """Unit vectors, shape (K - 1, n)."""
        return np.asarray(np.diff(self.corners, axis=0) / self.lengths[:, None])

    @property
    def turns(self) -> FloatArray:
        """Largest component of the change of direction at each corner, the ends 0, shape (K,)."""
        inner = np.abs(np.diff(self.directions, axis=0)).max(axis=1, initial=0.0)
        return np.concatenate([[0.0], inner, [0.0]])

    def margins(self, speeds: FloatArray) -> FloatArray:
        """How far from each corner its parabola begins, shape (K,); 0 where it is as good as none.

        A parabola of no duration would put several knots at one time.
        """
        durations = speeds * self.turns / self.acceleration
        margins = 0.5 * speeds * durations
        return np.where(durations < _INSTANT, 0.0, margins)

    def parabola(self, corner: int, speed: float, period: float) -> tuple[FloatArray, FloatArray]:
        """Times [s] from the beginning, and knots: shape (k,) and (k, n), both ends with them."""
        before, after = self.directions[corner - 1 : corner + 1]
        margin = speed * self.turns[corner] * speed / (2.0 * self.acceleration)
        duration = 2.0 * margin / speed
        count = max(_FEWEST, math.ceil(duration / period - 1e-9) + 1)
        times = np.linspace(0.0, duration, count)[:, None]
        bend = 0.5 * speed * (after - before) * times**2 / max(duration, 1e-12)
        knots = self.corners[corner] - margin * before + speed * before * times + bend
        return times[:, 0], knots


def corner_speeds(
    path: StraightPieces, deviation: float, is_free: FreeSegment, period: float
) -> FloatArray:
    """Path speeds at the corners, at the ends 0, that all limits allow, shape (K,).

    Args:
        path: the pieces.
        deviation: how far a joint may pass a corner [rad or m].
        is_free: asked for every chord of every parabola; where one is not, the path stops.
        period: longest time between two knots [s].
    """
    limits = _limits(path, deviation)
    while True:
        speeds = _reachable(path, limits)
        blocked = [
            corner
            for corner in map(int, np.flatnonzero(speeds))
            if not _is_clear(path.parabola(corner, float(speeds[corner]), period)[1], is_free)
        ]
        if not blocked:
            return speeds
        limits[blocked] = 0.0


def _limits(path: StraightPieces, deviation: float) -> FloatArray:
    """What each corner for itself allows."""
    limits = np.zeros(len(path.corners))
    if len(limits) < 3 or deviation <= 0.0:
        return limits
    turns = np.maximum(path.turns[1:-1], 1e-9)
    shorter = np.minimum(path.lengths[:-1], path.lengths[1:])
    limits[1:-1] = np.minimum(path.speeds[:-1], path.speeds[1:])
    limits[1:-1] = np.minimum(limits[1:-1], np.sqrt(8.0 * path.acceleration * deviation) / turns)
    room = np.sqrt(2.0 * path.acceleration * _HALF * shorter / turns)
    limits[1:-1] = np.minimum(limits[1:-1], room)
    return limits


def _reachable(path: StraightPieces, limits: FloatArray) -> FloatArray:
    """The speeds, lowered to what the pieces between the corners allow to reach."""
    speeds, margins = limits.copy(), path.margins(limits)
    gains = 2.0 * path.growths * (path.lengths - margins[:-1] - margins[1:])
    for at in range(1, len(speeds)):
        speeds[at] = min(speeds[at], math.sqrt(speeds[at - 1] ** 2 + gains[at - 1]))
    for at in range(len(speeds) - 2, -1, -1):
        speeds[at] = min(speeds[at], math.sqrt(speeds[at + 1] ** 2 + gains[at]))
    return speeds


def _is_clear(knots: FloatArray, is_free: FreeSegment) -> bool:
    return all(is_free(first, second) for first, second in pairwise(knots))


_STILL = 1e-9  # change of a position that is none [rad or m]


@dataclass(frozen=True)
class TrajectoryConfig:
    """How fast joints move.

    Raises:
        ConfigError: a value is out of its range.
    """

    velocity_share: float = parameter(
        0.5, "Share of the joints' largest speeds that is used.", low=0.01, high=1.0
    )
    default_velocity: ClassVar[float] = 0.5
    """Largest speed of a joint whose description gives none [rad/s or m/s]."""
    acceleration: float = parameter(
        1.0,
        "Largest acceleration of every joint; robot descriptions do not hold it.",
        unit="rad/s^2 or m/s^2",
        low=0.001,
        high=1000.0,
    )
    corner_deviation: float = setting(
        0.05,
        "How far a joint may pass beside a corner of a path so as not to stop there; the collision "
        "check decides whether it does. 0 stops at every corner.",
        unit="rad or m",
        low=0.0,
        high=1.0,
    )
    period: float = setting(
        0.05, "Longest time between two knots of a moving arm.", unit="s", low=0.001, high=10.0
    )

    def __post_init__(self) -> None:
        check_config(self)

    def velocities(self, chain: KinematicChain) -> FloatArray:
        """Speeds that the joints may have, shape (n,) [rad/s or m/s]."""
        known = np.where(np.isfinite(chain.velocity), chain.velocity, self.default_velocity)
        return np.asarray(self.velocity_share * known)


def time_path(
    chain: KinematicChain,
    waypoints: FloatArray,
    config: TrajectoryConfig | None = None,
    is_free: FreeSegment | None = None,
) -> ArmPath:
    """Give a path times.

    Args:
        chain: whose joints move.
        waypoints: corners of the path, shape (K, n) [rad or m], at least one.
        config: limits.
        is_free: whether a segment is free: corners that can be passed are; all are stopped at
            without it.

    Returns:
        The same path, but for its corners, with knots so close that straight lines between them
        keep the limits.

    Raises:
        InvalidInputError: `waypoints` has another shape or is not finite.
    """
    settings = config or TrajectoryConfig()
    corners = float_array(waypoints, "waypoints")
    if corners.ndim != 2 or corners.shape[1] != len(chain) or not len(corners):
        raise InvalidInputError("waypoints", f"shape {corners.shape}, expected (K, {len(chain)})")
    if not np.isfinite(corners).all():
        raise InvalidInputError("waypoints", "is not finite")
    corners = _distinct(corners)
    if len(corners) == 1:
        return ArmPath(chain.joint_names, corners, np.zeros(1))
    path = StraightPieces.of(corners, settings.velocities(chain), settings.acceleration)
    speeds = np.zeros(len(corners))
    if is_free is not None:
        speeds = corner_speeds(path, settings.corner_deviation, is_free, settings.period)
    positions, times = _time(path, speeds, settings.period)
    return ArmPath(chain.joint_names, positions, times)


def _distinct(corners: FloatArray) -> FloatArray:
    kept = [corners[0]]
    for corner in corners[1:]:
        if np.abs(corner - kept[-1]).max(initial=0.0) > _STILL:
            kept.append(corner)
    return np.array(kept)


def _time(path: StraightPieces, speeds: FloatArray, period: float) -> tuple[FloatArray, FloatArray]:
    """Knots and times of a path that passes its corners at some speeds."""
    margins = path.margins(speeds)
    positions, times = [path.corners[:1]], [np.zeros(1)]
    for piece, (direction, length) in enumerate(zip(path.directions, path.lengths, strict=True)):
        begin, end = margins[piece], length - margins[piece + 1]
        ends = float(speeds[piece]), float(speeds[piece + 1])
        limits = float(path.speeds[piece]), float(path.growths[piece])
        seconds, lengths = _profile(end - begin, ends, limits, period)
        positions.append(path.corners[piece] + (begin + lengths)[:, None] * direction)
        if margins[piece + 1] == 0.0:
            positions[-1][-1] = path.corners[piece + 1]
        times.append(times[-1][-1] + seconds)
        if margins[piece + 1] > 0.0:
            seconds, knots = path.parabola(piece + 1, ends[1], period)
            positions.append(knots[1:])
            times.append(times[-1][-1] + seconds[1:])
    return np.concatenate(positions), np.concatenate(times)


def _profile(
    length: float, ends: tuple[float, float], limits: tuple[float, float], period: float
) -> tuple[FloatArray, FloatArray]:
    """Times [s] and lengths of a piece, both without the start.

    Args:
        length: of the piece.
        ends: path speeds at its ends, which its length allows to reach from each other [1/s].
        limits: largest path speed [1/s] and its largest change [1/s^2].
        period: longest time between two knots [s].
    """
    (first, last), (speed, growth) = ends, limits
    top = min(speed, math.sqrt(growth * length + 0.5 * (first**2 + last**2)))
    top = max(top, first, last)
    rising, falling = (top - first) / growth, (top - last) / growth
    climb, fall = 0.5 * (top + first) * rising, 0.5 * (top + last) * falling
    even = max(length - climb - fall, 0.0) / top
    parts = ((rising, first, growth), (even, top, 0.0), (falling, top, -growth))
    seconds, lengths, begin, at = [], [], 0.0, 0.0
    for duration, start, change in parts:
        if duration < 1e-9:
            continue
        steps = np.linspace(0.0, duration, max(1, math.ceil(duration / period - 1e-9)) + 1)[1:]
        seconds.append(begin + steps)
        lengths.append(at + start * steps + 0.5 * change * steps**2)
        begin, at = float(seconds[-1][-1]), float(lengths[-1][-1])
    return np.concatenate(seconds), np.minimum(np.concatenate(lengths), length)


_TURN = 2.0 * np.pi
_NARROWEST = 1e-6  # [rad or m]; range of a joint that OMPL takes

util.setLogLevel(util.LOG_NONE)


_STEP = 0.25  # length of a new branch, as the farthest that a point of the body may go [m]


@dataclass(frozen=True)
class ArmPathConfig:
    """Effort of the search.

    Raises:
        ConfigError: a value is out of its range.
    """

    samples: int = setting(
        16000, "Random configurations after which the search for a path ends.", low=1, high=10**9
    )
    shortcuts: ClassVar[int] = 100
    """Number of attempts to shorten the path that was found, and then to leave out corners."""

    def __post_init__(self) -> None:
        check_config(self)


QUICK_SEARCH = ArmPathConfig(samples=3000)
"""For one path of several that are tried."""


def plan_arm_path(
    checker: CollisionChecker,
    q_start: ArrayLike,
    q_goal: ArrayLike,
    T_map_base: ArrayLike,
    config: ArmPathConfig | None = None,
    trajectory: TrajectoryConfig | None = None,
    seed: int = 0,
) -> ArmPath:
    """Plan a path of the arm while the base stands still.

    A start that touches something may be left, without coming nearer to what it touches; the goal
    must be free. A start beyond the limits, as encoders may report it, is taken to be at them.
    Joints that turn without end take the shorter turn.

    Args:
        checker: the robot in its map.
        q_start: positions of the arm, shape (n,) [rad or m].
        q_goal: shape (n,).
        T_map_base: where the base stands, shape (4, 4).
        config: effort.
        trajectory: limits of velocity and acceleration.
        seed: of the random search.

    Returns:
        The path with times, or why there is none.

    Raises:
        InvalidInputError: malformed positions or pose.
    """
    settings, chain = config or ArmPathConfig(), checker.body.chain
    start = np.clip(chain.check(q_start, "q_start"), chain.lower, chain.upper)
    goal = _shorter_turn(chain, start, chain.check(q_goal, "q_goal"))
    problem = _obstacle(checker, goal, T_map_base)
    if problem:
        return ArmPath.failed(chain.joint_names, problem)
    space, scratch = checker.departure(start, T_map_base), checker.body.scratch()

    def is_free(first: FloatArray, second: FloatArray) -> bool:
        return first_on_segment(space, first, second, scratch) < 0.0

    if is_free(start, goal):
        return time_path(chain, np.stack([start, goal]), trajectory)
    util.RNG.setSeed(seed + 1)  # 0 would be any
    found = _Search(checker, is_free, settings, (start, goal)).corners()
    if found is None:
        why = checker.contact_between(start, goal, T_map_base)
        return ArmPath.failed(
            chain.joint_names,
            f"no path of the arm found in {settings.samples} samples; straight on: {why}",
        )
    return time_path(chain, found, trajectory, is_free)


def _shorter_turn(chain: KinematicChain, start: FloatArray, goal: FloatArray) -> FloatArray:
    turns = np.round((goal - start) / _TURN)
    return np.where(chain.is_continuous, goal - _TURN * turns, goal)


def _obstacle(checker: CollisionChecker, goal: FloatArray, T_map_base: ArrayLike) -> str:
    """Why the goal cannot be taken, or empty."""
    chain = checker.body.chain
    beyond = (goal < chain.lower - 1e-9) | (goal > chain.upper + 1e-9)
    if beyond.any():
        return f"the goal is beyond the limits of {chain.joint_names[int(np.argmax(beyond))]}"
    touched = checker.contact(goal, T_map_base)
    return touched and f"the goal touches: {touched}"


class _Search:
    """OMPL's problem between two configurations; its states are positions times `weights`.

    Args:
        checker: the robot in its map.
        is_free: whether the segment between two configurations, shape (n,), touches nothing.
        config: effort.
        ends: start and goal, shape (n,) each.
    """

    def __init__(
        self,
        checker: CollisionChecker,
        is_free: Callable[[FloatArray, FloatArray], bool],
        config: ArmPathConfig,
        ends: tuple[FloatArray, FloatArray],
    ) -> None:
        self._config, self._ends, chain = config, ends, checker.body.chain
        # Farthest that a point of the body goes per unit of each joint, shape (n,).
        reach = checker.body.arrays.reach.max(axis=0, initial=0.0)
        self.weights = np.maximum(reach, 1e-3)
        # Within the limits, and for joints without any within a turn around.
        low = np.where(np.isfinite(chain.lower), chain.lower, np.minimum(*ends) - np.pi)
        high = np.where(np.isfinite(chain.upper), chain.upper, np.maximum(*ends) + np.pi)
        bounds = ob.RealVectorBounds(len(chain))
        for j, weight in enumerate(self.weights):
            bounds.setLow(j, float(weight * low[j]))
            bounds.setHigh(j, float(weight * max(high[j], low[j] + _NARROWEST)))
        self._states = ob.RealVectorStateSpace(len(chain))
        self._states.setBounds(bounds)
        self._information = ob.SpaceInformation(self._states)
        validity = ob.AllValidStateValidityChecker(self._information)
        self._information.setStateValidityChecker(validity)
        self._information.setMotionValidator(_Validator(self._information, is_free, self.weights))
        self._information.setup()

    def corners(self) -> FloatArray | None:
        """Configurations from start to goal with free straight lines between them, (K, n)."""
        problem = ob.ProblemDefinition(self._information)
        problem.setStartAndGoalStates(*(self._state(q) for q in self._ends))
        planner, samples = og.RRTConnect(self._information), iter(range(self._config.samples))
        planner.setRange(_STEP)
        planner.setProblemDefinition(problem)
        planner.setup()
        planner.solve(ob.PlannerTerminationCondition(lambda: next(samples, None) is None))
        if not problem.hasExactSolution():
            return None
        path, attempts = problem.getSolutionPath(), self._config.shortcuts
        simplifier = og.PathSimplifier(self._information)
        simplifier.partialShortcutPath(path, attempts, attempts, 1.0)
        simplifier.reduceVertices(path, attempts, attempts, 1.0)  # each corner takes time
        corners = np.array([_positions(state, self.weights) for state in path.getStates()])
        corners[0], corners[-1] = self._ends
        return corners

    def _state(self, q: FloatArray) -> Any:
        state = self._states.allocState()
        for j, value in enumerate(self.weights * q):
            state[j] = float(value)
        return state


class _Validator(ob.MotionValidator):  # type: ignore[misc]
    """Asks a function about each motion."""

    def __init__(
        self,
        information: Any,
        is_free: Callable[[FloatArray, FloatArray], bool],
        weights: FloatArray,
    ) -> None:
        super().__init__(information)
        self._is_free, self._weights = is_free, weights

    def checkMotion(self, first: Any, last: Any) -> bool:
        """As OMPL calls it."""
        return self._is_free(_positions(first, self._weights), _positions(last, self._weights))


def _positions(state: Any, weights: FloatArray) -> FloatArray:
    return np.array([state[j] for j in range(len(weights))]) / weights
