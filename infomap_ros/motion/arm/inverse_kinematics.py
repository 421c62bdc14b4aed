"""Joint positions that place the camera at a wanted pose."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from infomap_ros.errors import InvalidInputError
from infomap_ros.geometry import check_transform, check_transforms, float_array
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.mapping.scans.workers import Workers
from infomap_ros.motion.arm.ik_arm import arm_of, why_not
from infomap_ros.motion.arm.ik_kernels import Goal, make_scratch
from infomap_ros.motion.arm.ik_records import IkBatch, IkConfig, IkResult
from infomap_ros.motion.arm.ik_search import (
    Found,
    next_solution,
    out_of_reach,
    search_all,
    way_between,
)
from infomap_ros.motion.robot.chain import KinematicChain
from infomap_ros.motion.robot.robot_model import RobotModel

__all__ = ["IkBatch", "IkConfig", "IkResult", "solve_ik", "solve_ik_batch"]


def solve_ik(
    robot: RobotModel | KinematicChain,
    T_base_camera: ArrayLike,
    *,
    direction_only: bool = False,
    q_start: ArrayLike | None = None,
    config: IkConfig | None = None,
    is_valid: Callable[[FloatArray], bool] | None = None,
    seed: int = 0,
) -> IkResult:
    """Find joint positions within their limits that place the camera.

    Damped least squares from a start and, where that ends beside the target, from random ones
    (see `ik_kernels.descend`). Of positions that are whole turns apart, the one nearest to the
    start is returned.

    Args:
        robot: its `arm` is moved; or a chain.
        T_base_camera: wanted pose, shape (4, 4).
        direction_only: the camera's position and viewing direction count, the roll about its
            optical axis is free.
        q_start: where the search begins, shape (n,) [rad or m], clipped to the limits; the middle
            of the limits where not given.
        config: tolerances and effort.
        is_valid: a further condition, such as no collision, on positions, shape (n,). Solutions
            that it refuses do not count, and the search goes on.
        seed: of the random starts. The result depends on nothing but the arguments.

    Raises:
        InvalidInputError: the pose is not a rigid transform, or `q_start` is malformed.
        RobotModelError: the robot has no camera frame.
    """
    chain = robot if isinstance(robot, KinematicChain) else robot.arm
    search = _Search(chain, config or IkConfig(), direction_only, seed)
    target = check_transform(T_base_camera, "T_base_camera")
    start = _starts(chain, q_start, 1)[0]
    trials = list(search.trials(target, start, is_valid))
    valid = [trial for trial in trials if trial.converged]
    if not valid:
        return trials[-1]
    arm = arm_of(chain)
    return min(valid, key=lambda trial: float(way_between(arm, start, trial.q)))


def solve_ik_batch(
    robot: RobotModel | KinematicChain,
    T_base_cameras: ArrayLike,
    *,
    direction_only: bool = False,
    q_start: ArrayLike | None = None,
    config: IkConfig | None = None,
    seed: int = 0,
    threads: int = 1,
) -> IkBatch:
    """Solve `solve_ik` for many targets at once, compiled as a whole.

    Args:
        robot: its `arm` is moved; or a chain.
        T_base_cameras: wanted poses, shape (M, 4, 4).
        direction_only: as for `solve_ik`.
        q_start: one for all, shape (n,), or one for each, shape (M, n).
        config: tolerances and effort.
        seed: of the random starts; each target has its own.
        threads: number of threads. The result does not depend on it.

    Raises:
        InvalidInputError: a pose is not a rigid transform, `q_start` is malformed, or `threads` is
            not positive.
        RobotModelError: the robot has no camera frame.
    """
    if threads < 1:
        raise InvalidInputError("threads", f"is {threads}, expected at least 1")
    chain = robot if isinstance(robot, KinematicChain) else robot.arm
    search = _Search(chain, config or IkConfig(), direction_only, seed)
    targets = check_transforms(T_base_cameras, "T_base_cameras")
    starts = _starts(chain, q_start, len(targets))
    return search.batch(targets, starts, threads)


@dataclass(frozen=True)
class _Search:
    """What is the same for every target."""

    chain: KinematicChain
    config: IkConfig
    direction_only: bool
    seed: int

    @property
    def goal(self) -> Goal:
        config = self.config
        return Goal(
            self.direction_only,
            config.position_tolerance,
            config.rotation_tolerance,
            config.iterations,
        )

    def trials(
        self,
        target: FloatArray,
        start: FloatArray,
        is_valid: Callable[[FloatArray], bool] | None,
    ) -> Iterator[IkResult]:
        """Solutions, valid or refused, until enough are valid; without any, the best try."""
        chain, config, arm = self.chain, self.config, arm_of(self.chain)
        memory = make_scratch(len(chain.arrays.columns), len(chain))
        hopeless = out_of_reach(arm, target, config.position_tolerance)
        last = 1 if hopeless else config.restarts + 1
        attempt, valid, refused = -1, 0, 0
        while attempt + 1 < last and valid < config.solutions:
            q, span = np.empty(len(chain)), (attempt + 1, last)
            attempt, reached, distance, angle = next_solution(
                chain.arrays, arm, target, self.goal, start, self.seed, 0, span, q, memory
            )
            if reached and (is_valid is None or is_valid(q.copy())):
                valid += 1
                yield IkResult(q, True, "", distance, angle, attempt)
            elif reached:
                refused += 1
                reason = f"solutions found: {refused}, none of them valid"
                yield IkResult(q, False, reason, distance, angle, attempt)
            elif not valid and not refused:
                reason = self.reason(target, q, (distance, angle))
                yield IkResult(q, False, reason, distance, angle, attempt)

    def batch(self, targets: FloatArray, starts: FloatArray, threads: int) -> IkBatch:
        """Solve for targets, shape (M, 4, 4), from starts, shape (M, n)."""
        count, config, arm = len(targets), self.config, arm_of(self.chain)
        found = Found(
            np.empty_like(starts),
            np.zeros(count, dtype=bool),
            np.empty(count),
            np.empty(count),
            np.zeros(count, dtype=np.int64),
        )

        def solve(_: int, first: int, last: int) -> None:
            search_all(
                self.chain.arrays, arm, targets, self.goal, starts, self.seed,
                config.restarts + 1, config.solutions, (first, last), found,
            )  # fmt: skip

        Workers(threads).run(solve, count)
        errors = list(zip(found.distances.tolist(), found.angles.tolist(), strict=True))
        reasons = tuple(
            "" if converged else self.reason(*item)
            for converged, *item in zip(found.converged, targets, found.q, errors, strict=True)
        )
        return IkBatch(
            found.q, found.converged, reasons, found.distances, found.angles, found.restarts
        )

    def reason(self, target: FloatArray, q: FloatArray, errors: tuple[float, float]) -> str:
        """Why `q` does not do."""
        tolerances = self.config.position_tolerance, self.config.rotation_tolerance
        return why_not(self.chain, target, q, errors, tolerances, self.direction_only)


def _starts(chain: KinematicChain, q_start: ArrayLike | None, count: int) -> FloatArray:
    """Where the first attempts begin, within the limits, shape (count, n)."""
    arm, n = arm_of(chain), len(chain)
    if q_start is None:
        return np.tile(0.5 * (arm.low + arm.high), (count, 1))
    starts = float_array(q_start, "q_start")
    if starts.shape not in ((n,), (count, n)):
        raise InvalidInputError("q_start", f"shape {starts.shape}, expected ({n},)")
    if not np.isfinite(starts).all():
        raise InvalidInputError("q_start", "holds NaN or infinity")
    clipped = np.clip(starts, arm.lower, arm.upper)
    return np.array(np.broadcast_to(clipped, (count, n)), order="C")
