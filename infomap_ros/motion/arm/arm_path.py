"""A way of the arm that touches nothing, from one configuration to another.

The straight line in joint space if that is free, else a way found by two random trees that grow
towards each other (RRT-Connect), then shortened. All of a way is known to be free, not only the
configurations that were looked at (`way_kernels`).
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike

from infomap_ros.geometry.config import check_config, setting
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.motion.arm.arm_kernels import Trees, distance, grow
from infomap_ros.motion.arm.trajectory import TrajectoryConfig, time_path
from infomap_ros.motion.base.way_kernels import first_on_way
from infomap_ros.motion.collision.checker import CollisionChecker
from infomap_ros.motion.collision.kernels import MotionSpace
from infomap_ros.motion.robot.chain import KinematicChain
from infomap_ros.motion.route import ArmPath

__all__ = ["QUICK_SEARCH", "ArmPath", "ArmPathConfig", "plan_arm_path"]

_SAMPLES_AT_ONCE = 200
_TURN = 2.0 * np.pi


@dataclass(frozen=True)
class ArmPathConfig:
    """Effort of the search.

    Raises:
        ConfigError: a value is out of its range.
    """

    samples: int = setting(
        16000, "Random configurations after which the search for a way ends.", low=1, high=10**9
    )
    max_nodes: ClassVar[int] = 20000
    """Largest number of configurations in each of the two trees."""
    step: float = setting(
        0.25,
        "Length of a new branch, measured as the farthest that a point of the body may go.",
        unit="m",
        low=0.001,
        high=100.0,
    )
    shortcuts: ClassVar[int] = 100
    """Number of attempts to shorten the way that was found."""

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
    if first_on_way(space, start, goal, scratch) < 0.0:
        return time_path(chain, np.stack([start, goal]), trajectory)
    search = _Search(checker, space, settings, np.random.default_rng(seed))
    found = search.way(start, goal)
    if found is None:
        why = checker.first_on_way(start, goal, T_map_base).what
        return ArmPath.failed(
            chain.joint_names,
            f"no way of the arm found in {settings.samples} samples; straight on: {why}",
        )
    return time_path(chain, search.shortened(found), trajectory, search.is_free)


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


@dataclass(frozen=True, eq=False)
class _Search:
    """A search in one space."""

    checker: CollisionChecker
    space: MotionSpace
    config: ArmPathConfig
    rng: np.random.Generator

    @property
    def weights(self) -> FloatArray:
        """Farthest that a point of the body goes per unit of each joint, shape (n,)."""
        reach = self.checker.body.arrays.reach
        return np.maximum(reach.max(axis=0, initial=0.0), 1e-3)

    def way(self, start: FloatArray, goal: FloatArray) -> FloatArray | None:
        """Configurations from start to goal with free straight lines between them, (K, n)."""
        low, high = self._box(start, goal)
        capacity, count = self.config.max_nodes, len(start)
        trees = Trees(
            np.empty((2, capacity, count)), np.full((2, capacity), -1), np.ones(2, dtype=np.int64)
        )
        trees.nodes[0, 0], trees.nodes[1, 0] = start, goal
        joint, scratch = np.zeros(2, dtype=np.int64), self.checker.body.scratch()
        for begin in range(0, self.config.samples, _SAMPLES_AT_ONCE):
            if trees.counts.max() >= capacity:
                break
            size = min(_SAMPLES_AT_ONCE, self.config.samples - begin)
            samples = self.rng.uniform(low, high, (size, count))
            if grow(self.space, trees, samples, self.weights, self.config.step, scratch, joint):
                return _joined(trees, joint)
        return None

    def is_free(self, first: FloatArray, second: FloatArray) -> bool:
        """Whether the straight way between two configurations, shape (n,), touches nothing."""
        return first_on_way(self.space, first, second, self.checker.body.scratch()) < 0.0

    def shortened(self, way: FloatArray) -> FloatArray:
        """Replace parts of a way by straight lines, between random points on it."""
        for _ in range(self.config.shortcuts):
            if len(way) <= 2:
                break
            way = self._shortcut(way)
        return way

    def _shortcut(self, way: FloatArray) -> FloatArray:
        i, j = sorted(self.rng.choice(len(way) - 1, 2, replace=False))
        shares = np.where(self.rng.random(2) < 0.5, (0.0, 1.0), self.rng.random(2))
        first, second = (
            way[k + 1] if share == 1.0 else way[k] + share * (way[k + 1] - way[k])
            for k, share in zip((i, j), shares, strict=True)
        )
        between = np.concatenate([[first], way[i + 1 : j + 1], [second]])
        if self._length(np.stack([first, second])) > 0.999 * self._length(between):
            return way
        if not self.is_free(first, second):
            return way
        shorter = np.concatenate([way[: i + 1], [first, second], way[j + 1 :]])
        return shorter[np.append(True, np.abs(np.diff(shorter, axis=0)).max(axis=1) > 1e-9)]

    def _length(self, way: FloatArray) -> float:
        pieces = pairwise(way)
        return sum(distance(a, b, self.weights) for a, b in pieces)

    def _box(self, start: FloatArray, goal: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Where samples are drawn: the limits, and for joints without any, a turn around."""
        chain = self.checker.body.chain
        low = np.where(np.isfinite(chain.lower), chain.lower, np.minimum(start, goal) - np.pi)
        high = np.where(np.isfinite(chain.upper), chain.upper, np.maximum(start, goal) + np.pi)
        return low, high


def _joined(trees: Trees, joint: np.ndarray[tuple[int], np.dtype[np.int64]]) -> FloatArray:
    """The way from the root of the first tree over the joint node to the root of the second."""
    halves = []
    for side in (0, 1):
        node, rows = int(joint[side]), []
        while node >= 0:
            rows.append(trees.nodes[side, node])
            node = int(trees.parents[side, node])
        halves.append(rows)
    return np.array(halves[0][::-1] + halves[1][1:])
