"""Turns wanted velocities of the base into turns of its wheels."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from infomap_ros.geometry.config import check_config, setting
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.motion.base.path_following import PathFollowingConfig
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
        self._turned = self._told = 0.0  # sums of squares and products of turn rates
        self._way_turned = 0.0
        self.restart()

    def restart(self) -> None:
        """Stand with the wheels as they are."""
        self._body.command_rollers(0.0, 0.0)
        self._targets = self._last = self._before = self._body.wheel_angles
        self._speed = self._turn_rate = self._correction = 0.0

    @property
    def is_still(self) -> bool:
        """Whether the wheels are told to stand."""
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
            self._told += wheels * turned
            self._turned += turned**2
            self._way_turned += abs(turned) * period

    @property
    def fitting_gain(self) -> float:
        """The gain by which the base would have turned as it was told; 0 before it has turned."""
        return self._told / self._turned if self._way_turned > _ENOUGH_TURNED else 0.0

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

    def way(self) -> float:
        """Way of the wheels since the last call, mean of both sides [m]."""
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
