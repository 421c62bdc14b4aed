"""Joint positions that place the camera at a wanted pose."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

from infomap_ros.errors import InvalidInputError
from infomap_ros.geometry import check_transform, check_transforms, float_array
from infomap_ros.geometry.config import check_config, parameter
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.motion.arm.ik_kernels import (
    Arm,
    Goal,
    attempts_for,
    make_scratch,
    next_solution,
    search_all,
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
    chain, settings = _chain_of(robot), config or IkConfig()
    target = check_transform(T_base_camera, "T_base_camera")
    arm, goal = arm_of(chain), settings.goal(direction_only)
    start, q = _starts(chain, q_start, 1)[0], np.empty(len(chain))
    memory = make_scratch(len(chain.arrays.columns), len(chain))
    last = attempts_for(arm, target, goal, settings.restarts + 1)
    attempt, refused = -1, 0
    while attempt + 1 < last:
        attempt, reached, distance, angle = next_solution(
            chain.arrays, arm, target, goal, start, seed, 0, (attempt + 1, last), q, memory
        )
        if reached and (is_valid is None or is_valid(q.copy())):
            return IkResult(q, True, "", distance, angle, attempt)
        refused += reached
        if reached:
            reason = f"solutions found: {refused}, none of them valid"
            result = IkResult(q.copy(), False, reason, distance, angle, attempt)
        elif not refused:
            reason = why_not(chain, target, q, (distance, angle), goal)
            result = IkResult(q, False, reason, distance, angle, attempt)
    return result


def solve_ik_batch(
    robot: RobotModel | KinematicChain,
    T_base_cameras: ArrayLike,
    *,
    direction_only: bool = False,
    q_start: ArrayLike | None = None,
    config: IkConfig | None = None,
    seed: int = 0,
) -> IkBatch:
    """Solve `solve_ik` for many targets at once, compiled as a whole.

    Args:
        robot: its `arm` is moved; or a chain.
        T_base_cameras: wanted poses, shape (M, 4, 4).
        direction_only: as for `solve_ik`.
        q_start: one for all, shape (n,), or one for each, shape (M, n).
        config: tolerances and effort.
        seed: of the random starts; each target has its own.

    Raises:
        InvalidInputError: a pose is not a rigid transform, or `q_start` is malformed.
        RobotModelError: the robot has no camera frame.
    """
    chain, settings = _chain_of(robot), config or IkConfig()
    targets = check_transforms(T_base_cameras, "T_base_cameras")
    goal, starts = settings.goal(direction_only), _starts(chain, q_start, len(targets))
    found = search_all(
        chain.arrays, arm_of(chain), targets, goal, starts, seed, settings.restarts + 1
    )
    return IkBatch(*found)


def _chain_of(robot: RobotModel | KinematicChain) -> KinematicChain:
    return robot if isinstance(robot, KinematicChain) else robot.arm


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


@dataclass(frozen=True)
class IkConfig:
    """How exactly, and how long, joint positions are searched for.

    Raises:
        ConfigError: a value is out of its range.
    """

    position_tolerance: float = parameter(
        1e-4,
        "Largest distance between the camera and its target. Where the arm cannot reach a target "
        "exactly, the two tolerances also say how an error of the position is weighed against one "
        "of the rotation.",
        unit="m",
        low=1e-6,
        high=10.0,
    )
    rotation_tolerance: float = parameter(
        1e-3,
        "Largest angle between the camera and its target, or between their viewing directions.",
        unit="rad",
        low=1e-6,
        high=3.2,
    )
    restarts: int = parameter(
        50,
        "Random starts after the first one; each takes about 20 us.",
        low=0,
        high=100_000,
    )

    def __post_init__(self) -> None:
        check_config(self)

    def goal(self, direction_only: bool) -> Goal:
        """What a descent is to reach, the roll about the optical axis free or not."""
        return Goal(direction_only, self.position_tolerance, self.rotation_tolerance)


@dataclass(frozen=True, eq=False)
class IkResult:
    """Joint positions for one target.

    Attributes:
        q: positions of the chain, shape (n,) [rad or m]; where not converged, those of the least
            error that was found, or a refused solution.
        converged: within the tolerances and the limits, and valid.
        reason: why not converged, in words; empty where it is.
        position_error: distance of the camera at `q` from its target [m].
        rotation_error: angle at `q` between the camera and its target, or between their viewing
            directions [rad].
        restarts: random starts that were used.
    """

    q: FloatArray
    converged: bool
    reason: str
    position_error: float
    rotation_error: float
    restarts: int


@dataclass(frozen=True, eq=False)
class IkBatch:
    """Joint positions for M targets; see `IkResult`.

    Attributes:
        q: shape (M, n) [rad or m].
        converged: shape (M,).
        position_errors: shape (M,) [m].
        rotation_errors: shape (M,) [rad].
        restarts: shape (M,).
    """

    q: FloatArray
    converged: NDArray[np.bool_]
    position_errors: FloatArray
    rotation_errors: FloatArray
    restarts: NDArray[np.int64]


_AT_LIMIT = 1e-9  # [rad or m]
_SLIDE_WITHOUT_LIMIT = 1.0  # where random starts of a joint without limits end [m]


@lru_cache(maxsize=64)
def arm_of(chain: KinematicChain) -> Arm:
    """Describe a chain for a search."""
    half = np.where(chain.is_prismatic, _SLIDE_WITHOUT_LIMIT, math.pi)
    wide = ~(chain.upper - chain.lower <= 2.0 * half)
    wide &= ~chain.is_prismatic | ~np.isfinite(chain.upper - chain.lower)
    middle = np.clip(0.0, chain.lower + half, np.maximum(chain.upper - half, chain.lower + half))
    return Arm(
        lower=chain.lower,
        upper=chain.upper,
        prismatic=chain.is_prismatic,
        low=np.where(wide, middle - half, chain.lower),
        high=np.where(wide, middle + half, chain.upper),
        root=_root(chain),
        reach=_reach(chain),
    )


def why_not(
    chain: KinematicChain, T_base_camera: FloatArray, q: FloatArray, errors: Sequence[float],
    goal: Goal,
) -> str:  # fmt: skip
    """Say why `q`, the best that was found, is not good enough.

    Args:
        chain: of n joints.
        T_base_camera: wanted pose, shape (4, 4).
        q: shape (n,).
        errors: distance [m] and angle [rad] from the wanted pose.
        goal: what was to be reached.
    """
    arm = arm_of(chain)
    away = float(np.linalg.norm(T_base_camera[:3, 3] - arm.root))
    if away > arm.reach + goal.position_tolerance:
        if not len(chain):
            return f"no arm moves the camera, which is {away:.2f} m away"
        reach = f"joint '{chain.joint_names[0]}', the arm extends {arm.reach:.2f} m"
        return f"out of reach: {away:.2f} m from {reach}"
    parts = []
    if errors[0] > goal.position_tolerance:
        parts.append(f"position off by {_length(errors[0])}")
    if errors[1] > goal.rotation_tolerance:
        what = "direction" if goal.direction_only else "rotation"
        parts.append(f"{what} off by {_angle(errors[1])}")
    at_limit = (q - chain.lower < _AT_LIMIT) | (chain.upper - q < _AT_LIMIT)
    names = [f"'{chain.joint_names[index]}'" for index in np.flatnonzero(at_limit)]
    if names:
        parts.append("at the limits of joint " + ", ".join(names))
    return ", ".join(parts)


def _length(meters: float) -> str:
    if meters < 0.01:
        return f"{1000.0 * meters:.2g} mm"
    return f"{100.0 * meters:.1f} cm" if meters < 1.0 else f"{meters:.2f} m"


def _angle(radians: float) -> str:
    degrees = math.degrees(radians)
    return f"{degrees:.2g} deg" if degrees < 10.0 else f"{degrees:.0f} deg"


def _root(chain: KinematicChain) -> FloatArray:
    arrays = chain.arrays
    first = arrays.placements[0] if len(arrays.columns) else arrays.tail
    return np.ascontiguousarray(first[:, 3])


def _reach(chain: KinematicChain) -> float:
    """Length of the chain, stretched, from the origin of its first joint at zero."""
    arrays = chain.arrays
    if not len(arrays.columns):
        return 0.0
    lengths = np.linalg.norm(arrays.placements[1:, :, 3], axis=1).sum()
    slides = 0.0
    for column, scale, offset, prismatic in zip(*arrays[:4], strict=True):
        if prismatic:
            ends = scale * np.array([chain.lower[column], chain.upper[column]]) + offset
            slides += float(np.abs(ends).max())
    return float(lengths + slides + np.linalg.norm(arrays.tail[:, 3]))
