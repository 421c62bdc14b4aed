"""Moves the joints of the arm along a trajectory, no joint faster than it can.

Which trajectories ros2_control's joint_trajectory_controller accepts, as of ROS 2 Jazzy.

The checks of its ``validate_trajectory_msg`` for a controller of positions with its default
parameters; those of array sizes are made where messages are decoded.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import ArrayLike

from infomap_ros.errors import InvalidInputError, RobotModelError
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.messages.commands import ArmTrajectoryCommand
from infomap_ros.motion.robot.robot_model import RobotModel
from infomap_ros.motion.robot.urdf import Follower
from infomap_ros.simulation.body.robot_body import RobotBody

_TOLERANCE = 0.01  # [rad or m]
_SETTLING = 2.0  # [s] that joints may take to arrive after the last point
_DEFAULT_SPEED = 1.0  # [rad/s or m/s] where the description has no limit


class ArmMotion:
    """The servo targets of all joints, and the trajectory that moves some of them.

    Args:
        body: the robot.
        robot: its description, for the limits of the joints.
        followers: joints that mimic others, by name; they cannot be commanded.
    """

    def __init__(
        self, body: RobotBody, robot: RobotModel, followers: Mapping[str, Follower]
    ) -> None:
        self._body = body
        self._followers = _follower_columns(body.servos, followers)
        limits = [robot.joint(_leader(name, followers)) for name in body.servos]
        self._lower = np.array([limit.lower for limit in limits])
        self._upper = np.array([limit.upper for limit in limits])
        speeds = np.array([limit.velocity for limit in limits])
        self._speeds = np.where(np.isfinite(speeds), speeds, _DEFAULT_SPEED)
        self._targets = body.positions
        self._knots: FloatArray = self._targets[None]
        self._times = np.zeros(1)
        self._elapsed, self._late = np.inf, 0.0
        self.problem = ""

    @property
    def joints(self) -> tuple[str, ...]:
        """The joints that can be commanded."""
        followers = {self._body.servos[column] for column, *_ in self._followers}
        return tuple(name for name in self._body.servos if name not in followers)

    @property
    def active(self) -> bool:
        """Whether a trajectory is being followed."""
        return bool(np.isfinite(self._elapsed))

    def follow(self, names: Sequence[str], positions: ArrayLike, times: ArrayLike) -> None:
        """Start a trajectory; it takes the place of the one before.

        Args:
            names: n joints; the others hold where they are.
            positions: knots, shape (K, n) [rad or m], straight lines between them.
            times: when each is to be reached, from now, not decreasing, shape (K,) [s].

        Raises:
            RobotModelError: a joint is unknown.
            InvalidInputError: shapes do not fit, a number is not finite, times decrease, or a
                knot is outside a joint's limits.
        """
        knots, moments = np.array(positions, dtype=float), np.array(times, dtype=float)
        columns = self._columns(names)
        if knots.ndim != 2 or knots.shape != (len(moments), len(columns)) or not len(knots):
            raise InvalidInputError(
                "arm trajectory", f"shapes {knots.shape}, {moments.shape} for {len(columns)} joints"
            )
        if not (np.isfinite(knots).all() and np.isfinite(moments).all()):
            raise InvalidInputError("arm trajectory", "holds NaN or infinity")
        if (np.diff(moments) < 0.0).any() or moments[0] < 0.0:
            raise InvalidInputError("arm trajectory", "times decrease or begin before zero")
        self._check_limits(names, knots, columns)
        full = np.repeat(self._targets[None], len(knots) + 1, axis=0)
        full[1:, columns] = knots
        for follower, leader, factor, offset in self._followers:
            full[:, follower] = factor * full[:, leader] + offset
        self._knots, self._times = full, np.concatenate([[-1e-9], moments])
        self._elapsed, self.problem = 0.0, ""

    def stop(self) -> None:
        """Hold all joints where they are told to be now."""
        self._targets, self._elapsed = self._body.targets, np.inf

    def update(self, period: float) -> None:
        """Move the servos' targets on by one control period [s]."""
        if not self.active:
            return
        self._elapsed += period
        wanted = np.array(
            [np.interp(self._elapsed, self._times, column) for column in self._knots.T]
        )
        change = self._speeds * period
        self._targets = self._targets + np.clip(wanted - self._targets, -change, change)
        self._body.command_servos(self._targets)
        self._check_arrival(period)

    def _check_arrival(self, period: float) -> None:
        left = np.abs(self._knots[-1] - self._targets)
        if self._elapsed < self._times[-1] or left.max() > 0.0:
            self._late = 0.0
            return
        self._late += period
        error = np.abs(self._body.positions - self._knots[-1])
        if error.max() < _TOLERANCE:
            self._elapsed = np.inf
        elif self._late > _SETTLING:
            worst = int(np.argmax(error))
            self.problem = (
                f"joint '{self._body.servos[worst]}' is stuck {error[worst]:.3f} from its target"
            )
            self._elapsed = np.inf

    def _columns(self, names: Sequence[str]) -> list[int]:
        unknown = [name for name in names if name not in self.joints]
        if unknown:
            raise RobotModelError(f"arm trajectory: no such joint: {', '.join(unknown)}")
        return [self._body.servos.index(name) for name in names]

    def _check_limits(self, names: Sequence[str], knots: FloatArray, columns: list[int]) -> None:
        outside = (knots < self._lower[columns] - 1e-3) | (knots > self._upper[columns] + 1e-3)
        if outside.any():
            knot, column = np.argwhere(outside)[0]
            limit = f"{self._lower[columns[column]]:g} to {self._upper[columns[column]]:g}"
            problem = f"joint '{names[column]}' at {knots[knot, column]:.4f} is outside {limit}"
            raise InvalidInputError("arm trajectory", problem)


def _leader(name: str, followers: Mapping[str, Follower]) -> str:
    return followers[name].leader if name in followers else name


def _follower_columns(
    servos: Sequence[str], followers: Mapping[str, Follower]
) -> list[tuple[int, int, float, float]]:
    """Column of each follower and of its leader, factor and offset."""
    return [
        (servos.index(name), servos.index(item.leader), item.factor, item.offset)
        for name, item in followers.items()
        if name in servos and item.leader in servos
    ]


_NANOSECONDS = 1_000_000_000
_ZERO = float(np.finfo(np.float32).eps)  # [rad/s or m/s]


def why_refused(
    command: ArmTrajectoryCommand, joints: Sequence[str], now: int, *, allow_partial: bool = False
) -> str:
    """Why the controller refuses a trajectory; empty where it accepts it.

    Args:
        command: the trajectory.
        joints: of the controller.
        now: time of the controller's clock [ns].
        allow_partial: whether the trajectory may leave joints out.
    """
    if not allow_partial and len(command.names) != len(joints):
        return f"{len(command.names)} joints, the controller has {len(joints)}"
    foreign = [name for name in command.names if name not in joints]
    if foreign:
        return f"no such joint: {', '.join(foreign)}"
    if command.velocities is not None and (np.abs(command.velocities[-1]) > _ZERO).any():
        return "the last velocity is not zero"
    end = command.stamp + round(float(command.times[-1]) * _NANOSECONDS)
    if command.stamp and end < now:
        return f"it begins at a time and ends {(now - end) / _NANOSECONDS:.3f} s ago"
    if (np.diff(command.times) <= 0.0).any():
        return "times do not strictly increase"
    return ""
