"""What the base does: drives at a velocity, follows a path, or stands; and whether it is stuck.

Turns wanted velocities of the base into turns of its wheels.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from infomap_ros.geometry.config import check_config, setting
from infomap_ros.geometry.transforms import FloatArray, make_transform
from infomap_ros.motion.base.path_following import PathFollower, PathFollowingConfig, wrap
from infomap_ros.simulation.body.robot_body import RobotBody

_WINDUP = 0.3  # [rad] that a wheel may lag behind its target
_SKID = 1.4  # of a square robot's gain is skidding; measured with the rover
_ENOUGH_TURNED = 1.0  # [rad] by which the gain is judged
_WRONG = 1.5  # by this factor a gain is noticed


@dataclass(frozen=True)
class DriveTrainConfig:
    """Parameters of the wheels' control."""

    turn_gain: float = setting(
        0.0,
        "How much faster the wheels turn in a curve than they would without slipping sideways. "
        "0: 1 for two driven wheels, 1 + 1.4 (wheelbase / track)^2 for more, which skid, and "
        "1 + wheelbase / track for wheels with rollers.",
        low=0.0,
        high=5.0,
    )
    gyro_gain: ClassVar[float] = 2.0
    """Gain by which the measured turn rate corrects the wheels."""

    def __post_init__(self) -> None:
        """Validate all fields."""
        check_config(self)


class DriveTrain:
    """Drives the wheels of two sides, with limited acceleration.

    Args:
        body: the robot.
        config: the parameters.
        limits: of speed and acceleration.

    Attributes:
        gain: `DriveTrainConfig.turn_gain`, or what stands for it where that is 0.
        skids: whether a side has wheels one behind the other.
    """

    def __init__(
        self, body: RobotBody, config: DriveTrainConfig, limits: PathFollowingConfig
    ) -> None:
        self._body, self._config, self._limits = body, config, limits
        wheels = body.trial.wheels
        self.radius = float(np.mean([wheel.radius for wheel in wheels]))
        self._sides = np.array([wheel.place[1] for wheel in wheels])
        in_rows = bool(np.ptp([wheel.place[0] for wheel in wheels]) > self.radius)
        self.skids = in_rows and not body.setup.rollers
        base = body.frame(body.setup.base_frame)[:3, :3]
        axes = [base.T @ body.frame(w.body)[:3, :3] @ w.axis for w in wheels]
        self._signs = np.array([np.sign(axis[1]) for axis in axes])
        places = np.array([wheel.place for wheel in wheels])
        self.gain = config.turn_gain or _gain_by_geometry(places, body.setup.rollers)
        self._turned = self._commanded = 0.0  # sums of squares and products of turn rates
        self._total_turn = 0.0
        self.restart()

    def restart(self) -> None:
        """Stand with the wheels as they are."""
        self._body.command_rollers(0.0, 0.0)
        self._targets = self._last = self._before = self._body.wheel_angles
        self._speed = self._turn_rate = self._correction = 0.0

    @property
    def is_still(self) -> bool:
        """Whether the wheels are commanded to stand."""
        return self._speed == 0.0 and self._turn_rate == 0.0

    def update(self, speed: float, turn_rate: float, period: float) -> None:
        """Move the wheels' targets on.

        Args:
            speed: wanted, forward [m/s].
            turn_rate: wanted [rad/s].
            period: time until the next call [s].
        """
        limits, body = self._limits, self._body
        self._speed = _towards(self._speed, speed, limits.acceleration * period)
        change = limits.turn_acceleration * period
        self._turn_rate = _towards(self._turn_rate, turn_rate, change)
        self._correct(period)
        turn = self.gain * self._turn_rate + self._correction
        rates = self._signs * (self._speed - self._sides * turn) / self.radius
        angles = body.wheel_angles
        self._learn(angles, period)
        lag = np.clip(self._targets + rates * period - angles, -_WINDUP, _WINDUP)
        self._targets = angles + lag
        body.command_wheels(self._targets)
        body.command_rollers(self._speed, self._turn_rate)

    def _correct(self, period: float) -> None:
        if self._turn_rate == 0.0:
            self._correction = 0.0
            return
        error = self._turn_rate - float(self._body.base_velocity[5])
        bound = 2.0 * self.gain * self._limits.max_turn_rate
        wanted = self._correction + self._config.gyro_gain * error * period
        self._correction = float(np.clip(wanted, -bound, bound))

    def _learn(self, angles: FloatArray, period: float) -> None:
        """Note how fast the base turns, and how fast its wheels would turn it without slip."""
        rolled = self._signs * (angles - self._before) * self.radius / period  # [m/s]
        self._before = angles
        if self._turn_rate != 0.0:
            turned = float(self._body.base_velocity[5])
            wheels = -float(rolled @ self._sides / (self._sides @ self._sides))
            self._commanded += wheels * turned
            self._turned += turned**2
            self._total_turn += abs(turned) * period

    @property
    def fitting_gain(self) -> float:
        """The gain by which the base would have turned as commanded; 0 before it has turned."""
        return self._commanded / self._turned if self._total_turn > _ENOUGH_TURNED else 0.0

    @property
    def advice(self) -> str:
        """What is wrong with the gain, if it makes the base swing or creep; else empty."""
        fitting = self.fitting_gain
        if fitting <= 0.0 or 1.0 / _WRONG < fitting / self.gain < _WRONG:
            return ""
        does = "swings" if fitting < self.gain else "creeps"
        return (
            f"the base {does} when it turns: drive.turn_gain is {self.gain:.2g}, and by how it "
            f"turned {fitting:.2g} fits"
        )

    def distance_rolled(self) -> float:
        """Distance of the wheels since the last call, mean of both sides [m]."""
        angles = self._body.wheel_angles
        turned, self._last = self._signs * (angles - self._last), angles
        left = self._sides > 0.0
        return float(0.5 * (turned[left].mean() + turned[~left].mean()) * self.radius)


def _gain_by_geometry(places: FloatArray, rollers: bool) -> float:
    """Gain of wheels at places in the base frame, shape (W, 3) [m]; see `DriveTrainConfig`."""
    wheelbase, track = np.ptp(places, axis=0)[:2]
    ratio = float(wheelbase / track)
    return round(1.0 + (ratio if rollers else _SKID * ratio**2), 3)


def _towards(value: float, wanted: float, change: float) -> float:
    return value + float(np.clip(wanted - value, -change, change))


def planar(transform: FloatArray) -> FloatArray:
    """x, y [m] and yaw [rad] of a pose, shape (4, 4) -> (3,)."""
    yaw = np.arctan2(transform[1, 0], transform[0, 0])
    return np.array([transform[0, 3], transform[1, 3], yaw])


def level_pose(place: ArrayLike, yaw: float) -> FloatArray:
    """Pose of a base at a place, shape (3,) [m], that is not tilted, shape (4, 4)."""
    return make_transform(Rotation.from_euler("z", yaw).as_matrix(), place)


_TILT_MARGIN = 0.1  # [rad]


@dataclass(frozen=True)
class BaseMotionConfig:
    """Parameters of the watch over the base."""

    command_timeout: ClassVar[float] = 0.5
    """A velocity holds so long without being repeated [s]."""
    stuck_time: ClassVar[float] = 4.0
    """Without progress for so long it is stuck, and stops [s]."""
    stuck_distance: ClassVar[float] = 0.02
    """What counts as progress: such a distance... [m]"""
    stuck_angle: ClassVar[float] = 0.05
    """...or such a turn [rad]."""

    max_tilt: ClassVar[float] = 0.45
    """Where it tilts more it stops [rad]."""

    def __post_init__(self) -> None:
        """Validate all fields."""
        check_config(self)


class BaseMotion:
    """Carries out the last command to the base.

    Args:
        drive: the wheels.
        config: the parameters.
        following: how paths are followed.
    """

    def __init__(
        self, drive: DriveTrain, config: BaseMotionConfig, following: PathFollowingConfig
    ) -> None:
        self._drive, self._config, self._following = drive, config, following
        self._follower: PathFollower | None = None
        self._path_frame: FloatArray = np.zeros(3)
        self._velocity, self._remaining = (0.0, 0.0), 0.0
        self._mark: FloatArray | None = None
        self._waited = 0.0
        self._first_tilt: float | None = None
        self.problem = ""

    @property
    def active(self) -> bool:
        """Whether the base is being driven."""
        return self._follower is not None or self._remaining > 0.0 or not self._drive.is_still

    def follow(self, poses: FloatArray, T_odom_path: FloatArray | None) -> None:
        """Follow a path.

        Args:
            poses: x, y [m], yaw [rad], shape (K, 3).
            T_odom_path: frame of the poses in odom, shape (4, 4); None where they are in odom.

        Raises:
            InvalidInputError: as `PathFollower`.
        """
        self._follower = PathFollower(poses, self._following)
        self.correct(np.eye(4) if T_odom_path is None else T_odom_path)
        self._start()

    def correct(self, T_odom_path: FloatArray) -> None:
        """Localization has found the frame of the path to be here in odom, shape (4, 4)."""
        self._path_frame = planar(T_odom_path)

    def drive(self, speed: float, turn_rate: float) -> None:
        """Drive at a velocity [m/s, rad/s] until it times out; ends the path."""
        limits = self._following
        self._velocity = (
            float(np.clip(speed, -limits.max_speed, limits.max_speed)),
            float(np.clip(turn_rate, -limits.max_turn_rate, limits.max_turn_rate)),
        )
        if self._follower is not None or self._remaining <= 0.0:
            self._start()
        self._follower = None
        self._remaining = self._config.command_timeout

    def stop(self) -> None:
        """Forget the path and stand."""
        self._follower, self._remaining = None, 0.0

    def _start(self) -> None:
        self._remaining, self._waited, self.problem = 0.0, 0.0, ""
        self._mark = self._first_tilt = None

    def update(self, odometry: FloatArray, truth: FloatArray, period: float) -> None:
        """Drive on for one control period.

        Args:
            odometry: x, y, yaw that the robot believes, shape (3,).
            truth: ``T_world_base``, shape (4, 4); what it is watched by.
            period: [s].
        """
        wanted = (0.0, 0.0)
        if self._follower is not None:
            wanted = self._follower.velocity(_seen_from(self._path_frame, odometry))
            if self._follower.done:
                self._follower = None
        elif self._remaining > 0.0:
            self._remaining -= period
            wanted = self._velocity
        self._watch(planar(truth), wanted, period)
        self._watch_tilt(float(np.arccos(np.clip(truth[2, 2], -1.0, 1.0))))
        if self.problem:
            wanted = (0.0, 0.0)
        self._drive.update(*wanted, period)

    def _watch(self, place: FloatArray, wanted: tuple[float, float], period: float) -> None:
        """Notice that it should move and does not."""
        if self._mark is None or wanted == (0.0, 0.0) or self._has_moved(place - self._mark):
            self._mark, self._waited = place, 0.0
            return
        self._waited += period
        if self._waited > self._config.stuck_time:
            self.problem = f"the base is stuck at x {place[0]:.2f}, y {place[1]:.2f}"
            self.stop()

    def _watch_tilt(self, tilt: float) -> None:
        """Stop before it tips over; what tilts too much already may drive out of it."""
        if self._first_tilt is None:
            self._first_tilt = tilt
        if self.active and tilt > max(self._config.max_tilt, self._first_tilt + _TILT_MARGIN):
            self.problem = f"the base tilts by {np.degrees(tilt):.0f} degrees"
            self.stop()
            self._drive.restart()  # brakes: a ramp would drive it on up what it leans on

    def _has_moved(self, change: FloatArray) -> bool:
        moved = float(np.linalg.norm(change[:2])) > self._config.stuck_distance
        return moved or abs(wrap(change[2])) > self._config.stuck_angle


def _seen_from(frame: FloatArray, pose: FloatArray) -> FloatArray:
    """A planar pose in the coordinates of a planar frame; x, y [m], yaw [rad] each, shape (3,)."""
    x, y, yaw = pose - frame
    cosine, sine = np.cos(frame[2]), np.sin(frame[2])
    return np.array([cosine * x + sine * y, cosine * y - sine * x, wrap(yaw)])
