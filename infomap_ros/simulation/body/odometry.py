"""Dead reckoning as a rover does it: motion increments with slip and noise, and a covariance."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from infomap_ros.geometry import invert_transform, make_transform, skew
from infomap_ros.geometry.config import check_config, parameter
from infomap_ros.geometry.transforms import FloatArray


@dataclass(frozen=True)
class OdometryConfig:
    """Parameters of the dead reckoning."""

    slip: float = parameter(
        0.03, "Standard deviation of the wheels' constant slip, share of the way", low=0.0, high=1.0
    )
    translation_noise: float = parameter(
        0.01,
        "Position noise after 1 m, grows with the root of the way",
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


_STANDSTILL = np.diag([1e-6] * 3 + [1e-6] * 3)
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
        self._way = np.zeros(3)

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
        self._way += step
        turn = make_transform(Rotation.from_rotvec(turned).as_matrix(), moved)
        self._transform = self._transform @ turn

    def _covariance(self) -> FloatArray:
        """Noise plus the slip, which is the same at every step and so grows along the way."""
        slip = np.concatenate([self._way, np.zeros(3)]) * self._config.slip
        return self._noise + np.outer(slip, slip) + _STANDSTILL
