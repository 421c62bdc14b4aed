"""Dead reckoning as a robot does it: wheel encoders for the distance, a gyroscope for the turns.

What the wheels slip, the encoders do not see. Roll and pitch come from the gyroscope, corrected by
gravity; heading comes from the gyroscope alone and drifts.

Dead reckoning as a rover does it: motion increments with slip and noise, and a covariance.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from scipy.spatial.transform import Rotation

from infomap_ros.errors import SimulationError
from infomap_ros.geometry import invert_transform, make_transform, skew
from infomap_ros.geometry.config import check_config, parameter, setting
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.simulation.body.base_motion import level_pose, planar


@dataclass(frozen=True)
class OdometryConfig:
    """Parameters of the dead reckoning."""

    slip: float = parameter(
        0.03, "Standard deviation of wheels' constant slip, share of distance", low=0.0, high=1.0
    )
    translation_noise: float = parameter(
        0.01,
        "Position noise after 1 m, grows with the root of the distance",
        unit="m",
        low=0.0,
        high=1.0,
    )
    rotation_noise: float = parameter(
        0.01, "Rotation noise after 1 m or 1 rad", unit="rad", low=0.0, high=1.0
    )

    def __post_init__(self) -> None:
        """Validate all fields."""
        check_config(self)


@dataclass(frozen=True, eq=False)
class OdometryEstimate:
    """Dead-reckoned pose and velocity.

    Attributes:
        transform: ``T_odom_base``, shape (4, 4).
        covariance: of the pose, shape (6, 6), convention of `geometry.transforms`.
        twist: linear [m/s] and angular [rad/s] velocity in the base frame, shape (6,).
        twist_covariance: shape (6, 6).
    """

    transform: FloatArray
    covariance: FloatArray
    twist: FloatArray
    twist_covariance: FloatArray


_STANDSTILL = np.diag([1e-6] * 6)
"""Smallest variance that is ever reported: (1 mm)^2, (1 mrad)^2."""


class Odometry:
    """Integrates noisy increments of the true motion; the odom frame is the first base pose.

    Args:
        config: the parameters.
        rng: source of slip and noise.
    """

    def __init__(self, config: OdometryConfig, rng: np.random.Generator) -> None:
        self._config, self._rng = config, rng
        self._slip = rng.normal(0.0, config.slip)
        self._transform = np.eye(4)
        self._last_truth: FloatArray | None = None
        self._noise = np.zeros((6, 6))
        self._displacement = np.zeros(3)

    def step(self, T_world_base: FloatArray, duration: float) -> OdometryEstimate:
        """Advance to the present true pose, shape (4, 4), `duration` [s] after the last one."""
        if self._last_truth is None:
            self._last_truth = T_world_base
        motion = invert_transform(self._last_truth) @ T_world_base
        self._last_truth = T_world_base
        moved = motion[:3, 3]
        turned = Rotation.from_matrix(motion[:3, :3]).as_rotvec()
        effort = float(np.linalg.norm(moved) + np.linalg.norm(turned))
        sigma = np.sqrt(effort) * np.repeat(
            [self._config.translation_noise, self._config.rotation_noise], 3
        )
        noise = self._rng.normal(0.0, sigma)
        measured = (1.0 + self._slip) * moved + noise[:3]
        self._advance(measured, turned + noise[3:], sigma)
        twist = np.concatenate([measured, turned + noise[3:]]) / max(duration, 1e-9)
        slip = np.diag([*(self._config.slip * twist[:3]) ** 2, 0.0, 0.0, 0.0])
        rate_noise = np.diag((sigma / max(duration, 1e-9)) ** 2)
        return OdometryEstimate(
            self._transform.copy(), self._covariance(), twist, rate_noise + slip + _STANDSTILL
        )

    def _advance(self, moved: FloatArray, turned: FloatArray, sigma: FloatArray) -> None:
        """First-order propagation of the error: dt' = dt - [R m] dtheta + R n."""
        rotation = self._transform[:3, :3]
        step = rotation @ moved
        forward = np.eye(6)
        forward[:3, 3:] = -skew(step)
        spread = np.kron(np.eye(2), rotation)
        self._noise = forward @ self._noise @ forward.T + spread @ np.diag(sigma**2) @ spread.T
        self._displacement += step
        turn = make_transform(Rotation.from_rotvec(turned).as_matrix(), moved)
        self._transform = self._transform @ turn

    def _covariance(self) -> FloatArray:
        """Noise plus the slip, which is the same at every step and so grows along the path."""
        slip = np.concatenate([self._displacement, np.zeros(3)]) * self._config.slip
        return self._noise + np.outer(slip, slip) + _STANDSTILL


_COUNTED = ("scale", "gyro_scale", "position", "heading", "noise", "displacement", "turned")


@dataclass(frozen=True)
class WheelOdometryConfig:
    """Parameters of the dead reckoning."""

    scale_error: float = setting(
        0.01, "Standard deviation of the wheel radius' error, as share.", low=0.0, high=0.5
    )
    encoder_noise: ClassVar[float] = 0.004
    """Noise of the distance after 1 m, grows with its root [m]."""
    slip: ClassVar[float] = 0.05
    """Slip that is to be expected, as share of the distance."""
    side_slip: ClassVar[float] = 0.04
    """Slip in any direction after 1 m, grows with its root [m]."""
    turn_slip: ClassVar[float] = 0.05
    """Slip in any direction after a turn of 1 rad, grows with its root [m]."""
    gyro_scale_error: ClassVar[float] = 0.005
    """Standard deviation of the gyroscope's scale, as share."""
    gyro_noise: ClassVar[float] = 0.003
    """Noise of a turn after 1 rad or 1 m, grows with its root [rad]."""
    tilt_noise: ClassVar[float] = 0.002
    """Standard deviation of roll and pitch [rad]."""

    def __post_init__(self) -> None:
        """Validate all fields."""
        check_config(self)


class WheelOdometry:
    """Integrates encoders and gyroscope; the odom frame is the first base pose, made level.

    The origin of odom is the first place of the base, its z axis is vertical, its x axis points
    where the base does.

    Args:
        config: the parameters.
        T_world_base: the first true pose, shape (4, 4).
        rng: source of the errors.
    """

    def __init__(
        self, config: WheelOdometryConfig, T_world_base: FloatArray, rng: np.random.Generator
    ) -> None:
        self._config, self._rng = config, rng
        self._scale = 1.0 + rng.normal(0.0, config.scale_error)
        self._gyro_scale = 1.0 + rng.normal(0.0, config.gyro_scale_error)
        self.T_world_odom = level_pose(T_world_base[:3, 3], planar(T_world_base)[2])
        self._last = T_world_base
        self._position = np.zeros(3)
        self._heading = 0.0
        self._noise = np.zeros((6, 6))
        self._noise[3:5, 3:5] = np.eye(2) * config.tilt_noise**2
        self._displacement = np.zeros(3)
        self._turned = 0.0
        self._twist = np.zeros(6)
        self._sigma = np.zeros(6)

    def step(self, T_world_base: FloatArray, distance: float, duration: float) -> None:
        """Advance by one reading.

        Args:
            T_world_base: the present true pose, shape (4, 4): what the gyroscope and gravity feel.
            distance: mean turn of the wheels since the last reading times their radius [m].
            duration: since the last reading [s].
        """
        config = self._config
        motion = self._last[:3, :3].T @ T_world_base[:3, :3]
        self._last = T_world_base
        yaw = float(np.arctan2(motion[1, 0], motion[0, 0]))
        effort = abs(distance) + abs(yaw)
        sigma_distance = config.encoder_noise * np.sqrt(abs(distance))
        sigma_turn = config.gyro_noise * np.sqrt(effort)
        measured = self._scale * distance + self._rng.normal(0.0, sigma_distance)
        turn = self._gyro_scale * yaw + self._rng.normal(0.0, sigma_turn)
        self._heading += turn
        rotation = self._rotation(T_world_base)
        step = rotation @ (measured, 0.0, 0.0)
        self._position = self._position + step
        self._spread(rotation, step, sigma_distance, abs(yaw), sigma_turn)
        self._displacement += step
        self._turned += turn
        self._twist = np.array([measured, 0.0, 0.0, 0.0, 0.0, turn]) / max(duration, 1e-9)

    def state(self) -> dict[str, FloatArray]:
        """What it has counted so far, and its own errors, as arrays by name."""
        return {name: np.array(getattr(self, f"_{name}")) for name in _COUNTED} | {
            "T_world_odom": self.T_world_odom
        }

    def restore(self, state: Mapping[str, FloatArray], T_world_base: FloatArray) -> None:
        """Count on from `state`, with the base at a true pose, shape (4, 4).

        Raises:
            SimulationError: an array is missing or has another shape.
        """
        for name, own in self.state().items():
            if name not in state or state[name].shape != own.shape:
                raise SimulationError(f"the saved odometry has no {name} of shape {own.shape}")
        for name in _COUNTED:
            value = state[name]
            setattr(self, f"_{name}", float(value) if value.ndim == 0 else np.array(value))
        self.T_world_odom, self._last = np.array(state["T_world_odom"]), T_world_base

    def planar_pose(self) -> FloatArray:
        """x, y [m], yaw [rad] in odom, shape (3,)."""
        return np.array([self._position[0], self._position[1], self._heading])

    def estimate(self) -> OdometryEstimate:
        """The present estimate; roll and pitch carry the noise of this reading."""
        tilt = self._rng.normal(0.0, self._config.tilt_noise, 2)
        noise = Rotation.from_rotvec((*tilt, 0.0)).as_matrix()
        pose = make_transform(noise @ self._rotation(self._last), self._position)
        slip = (self._config.slip * self._twist[0]) ** 2 + (0.02 * self._twist[5]) ** 2
        rate = np.diag([slip, slip, slip, 1e-5, 1e-5, (0.02 * self._twist[5]) ** 2])
        return OdometryEstimate(pose, self._covariance(), self._twist.copy(), rate + _STANDSTILL)

    def _rotation(self, T_world_base: FloatArray) -> FloatArray:
        """True roll and pitch under the heading that is believed."""
        truth = T_world_base[:3, :3]
        heading = np.arctan2(truth[1, 0], truth[0, 0])
        cosine, sine = np.cos(self._heading - heading), np.sin(self._heading - heading)
        turn = np.array([[cosine, -sine, 0.0], [sine, cosine, 0.0], [0.0, 0.0, 1.0]])
        return np.asarray(turn @ truth)

    def _spread(
        self, rotation: FloatArray, step: FloatArray, distance: float, yaw: float, turn: float
    ) -> None:
        """First-order propagation: dt' = dt - [step] dtheta + R n."""
        forward = np.eye(6)
        forward[:3, 3:] = -skew(step)
        own = np.diag([distance**2, 0.0, 0.0])
        slip = self._config.side_slip**2 * float(np.linalg.norm(step))
        own += np.diag([1.0, 1.0, 0.1]) * (slip + self._config.turn_slip**2 * yaw)
        self._noise = forward @ self._noise @ forward.T
        self._noise[:3, :3] += rotation @ own @ rotation.T
        self._noise[5, 5] += turn**2

    def _covariance(self) -> FloatArray:
        """Noise, and the scale errors, which are the same all the time."""
        config = self._config
        scale = np.concatenate([self._displacement, np.zeros(3)])
        share = np.hypot(config.scale_error, config.slip)
        covariance = self._noise + np.outer(scale, scale) * share**2 + _STANDSTILL
        covariance[5, 5] += (config.gyro_scale_error * self._turned) ** 2
        return np.asarray(covariance)
