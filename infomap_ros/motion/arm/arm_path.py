"""A way of the arm that touches nothing, from one configuration to another.

The straight line in joint space if that is free, else a way found by two random trees that grow
towards each other, then shortened: OMPL's RRT-Connect (Kuffner and LaValle 2000,
https://doi.org/10.1109/ROBOT.2000.844730) and PathSimplifier. All of a way is known to be free, not
only the configurations that were looked at (`way_kernels`). The effort is a number of samples: a
clock would make a way depend on what else the machine does.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike
from ompl import base as ob
from ompl import geometric as og
from ompl import util

from infomap_ros.geometry.config import check_config, setting
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.motion.arm.trajectory import TrajectoryConfig, time_path
from infomap_ros.motion.base.way_kernels import first_on_way
from infomap_ros.motion.collision.checker import CollisionChecker
from infomap_ros.motion.robot.chain import KinematicChain
from infomap_ros.motion.route import ArmPath

__all__ = ["QUICK_SEARCH", "ArmPath", "ArmPathConfig", "plan_arm_path"]

_TURN = 2.0 * np.pi
_NARROWEST = 1e-6  # [rad or m]; range of a joint that OMPL takes

util.setLogLevel(util.LOG_NONE)


@dataclass(frozen=True)
class ArmPathConfig:
    """Effort of the search.

    Raises:
        ConfigError: a value is out of its range.
    """

    samples: int = setting(
        16000, "Random configurations after which the search for a way ends.", low=1, high=10**9
    )
    step: float = setting(
        0.25,
        "Length of a new branch, measured as the farthest that a point of the body may go.",
        unit="m",
        low=0.001,
        high=100.0,
    )
    shortcuts: ClassVar[int] = 100
    """Number of attempts to shorten the way that was found, and then to leave out corners."""

    def __post_init__(self) -> None:
        check_config(self)


QUICK_SEARCH = ArmPathConfig(samples=3000)
"""For one way of several that are tried."""


def plan_arm_path(
    checker: CollisionChecker,
    q_start: ArrayLike,
    q_goal: ArrayLike,
    T_map_base: ArrayLike,
    config: ArmPathConfig | None = None,
    trajectory: TrajectoryConfig | None = None,
    seed: int = 0,
) -> ArmPath:
    """Plan a way of the arm while the base stands still.

    A start that touches something may be left, without coming nearer to what it touches; the goal
    must be free. A start beyond the limits, as encoders may report it, is taken to be at them.
    Joints that turn without end take the shorter way round.

    Args:
        checker: the robot in its map.
        q_start: positions of the arm, shape (n,) [rad or m].
        q_goal: shape (n,).
        T_map_base: where the base stands, shape (4, 4).
        config: effort.
        trajectory: limits of velocity and acceleration.
        seed: of the random search.

    Returns:
        The way with times, or why there is none.

    Raises:
        InvalidInputError: malformed positions or pose.
    """
    settings, chain = config or ArmPathConfig(), checker.body.chain
    start = np.clip(chain.check(q_start, "q_start"), chain.lower, chain.upper)
    goal = _shorter_way_round(chain, start, chain.check(q_goal, "q_goal"))
    problem = _obstacle(checker, goal, T_map_base)
    if problem:
        return ArmPath.failed(chain.joint_names, problem)
    space, scratch = checker.departure(start, T_map_base), checker.body.scratch()

    def is_free(first: FloatArray, second: FloatArray) -> bool:
        return first_on_way(space, first, second, scratch) < 0.0

    if is_free(start, goal):
        return time_path(chain, np.stack([start, goal]), trajectory)
    util.RNG.setSeed(seed + 1)  # 0 would be any
    found = _Search(checker, is_free, settings, (start, goal)).way()
    if found is None:
        why = checker.first_on_way(start, goal, T_map_base).what
        return ArmPath.failed(
            chain.joint_names,
            f"no way of the arm found in {settings.samples} samples; straight on: {why}",
        )
    return time_path(chain, found, trajectory, is_free)


def _shorter_way_round(chain: KinematicChain, start: FloatArray, goal: FloatArray) -> FloatArray:
    turns = np.round((goal - start) / _TURN)
    return np.where(chain.is_continuous, goal - _TURN * turns, goal)


def _obstacle(checker: CollisionChecker, goal: FloatArray, T_map_base: ArrayLike) -> str:
    """Why the goal cannot be taken, or empty."""
    chain = checker.body.chain
    beyond = (goal < chain.lower - 1e-9) | (goal > chain.upper + 1e-9)
    if beyond.any():
        return f"the goal is beyond the limits of {chain.joint_names[int(np.argmax(beyond))]}"
    report = checker.check(goal, T_map_base, base=False)
    return "" if report.free else f"the goal touches: {report.what}"


class _Search:
    """OMPL's problem between two configurations; its states are positions times `weights`.

    Args:
        checker: the robot in its map.
        is_free: whether the straight way between two configurations, shape (n,), touches nothing.
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

    def way(self) -> FloatArray | None:
        """Configurations from start to goal with free straight lines between them, (K, n)."""
        problem = ob.ProblemDefinition(self._information)
        problem.setStartAndGoalStates(*(self._state(q) for q in self._ends))
        planner, samples = og.RRTConnect(self._information), iter(range(self._config.samples))
        planner.setRange(self._config.step)
        planner.setProblemDefinition(problem)
        planner.setup()
        planner.solve(ob.PlannerTerminationCondition(lambda: next(samples, None) is None))
        if not problem.hasExactSolution():
            return None
        path, attempts = problem.getSolutionPath(), self._config.shortcuts
        simplifier = og.PathSimplifier(self._information)
        simplifier.partialShortcutPath(path, attempts, attempts, 1.0)
        simplifier.reduceVertices(path, attempts, attempts, 1.0)  # each corner takes time
        way = np.array([_positions(state, self.weights) for state in path.getStates()])
        way[0], way[-1] = self._ends
        return way

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
