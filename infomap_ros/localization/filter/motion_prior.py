"""How the camera is expected to have moved between two images, and how well that is known."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from scipy.spatial.transform import Rotation

from infomap_ros.geometry import (
    carry_covariance,
    check_covariance,
    check_transform,
    compose_poses,
    invert_transform,
    skew,
)
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.localization.dead_reckoning import DeadReckoningConfig

_REST_DISTANCE, _REST_TURN = 0.003, 0.003  # [m], [rad]: encoders are noisy


@dataclass(frozen=True, eq=False)
class MotionPrior:
    """Expected motion of the camera.

    Attributes:
        T_before_after: pose of the new camera in the old one's frame, shape (4, 4).
        covariance: of that pose, in the old camera's frame, shape (6, 6) (docs/conventions.md).

    Raises:
        InvalidInputError: not a rigid transform, or not a covariance.
    """

    T_before_after: FloatArray
    covariance: FloatArray

    def __post_init__(self) -> None:
        transform = check_transform(self.T_before_after, "T_before_after")
        object.__setattr__(self, "T_before_after", transform)
        object.__setattr__(self, "covariance", check_covariance(self.covariance, 6))

    @property
    def is_rest(self) -> bool:
        """Whether no more motion is expected than encoders show at rest."""
        distance = float(np.linalg.norm(self.T_before_after[:3, 3]))
        turned = float(Rotation.from_matrix(self.T_before_after[:3, :3]).magnitude())
        return distance <= _REST_DISTANCE and turned <= _REST_TURN

    def then(self, later: MotionPrior) -> MotionPrior:
        """This motion followed by another one, whose error is independent."""
        own = self.T_before_after, self.covariance
        return MotionPrior(*compose_poses(*own, later.T_before_after, later.covariance))


@dataclass(frozen=True)
class RobotPosture:
    """Where odometry and joints say that the robot and its camera are.

    Attributes:
        T_odom_base: pose of the base in the frame of odometry, shape (4, 4).
        T_base_camera: pose of the camera on the base, by forward kinematics, shape (4, 4).
    """

    T_odom_base: FloatArray
    T_base_camera: FloatArray

    @property
    def T_odom_camera(self) -> FloatArray:
        """Pose of the camera in the frame of odometry, shape (4, 4)."""
        return self.T_odom_base @ self.T_base_camera


@dataclass(frozen=True)
class KinematicMotion:
    """Prior from wheel odometry and the arm's forward kinematics.

    Odometry errs by independent steps, so its variances grow in proportion to the distance; the
    kinematics (play, suspension) err anew at both ends.

    Attributes:
        config: how far both are to be trusted.
    """

    config: DeadReckoningConfig = field(default_factory=DeadReckoningConfig)

    @property
    def odometry_alone(self) -> KinematicMotion:
        """The same without errors of the kinematics."""
        tiny = 1e-4  # [m, rad]
        sigmas = {"kinematics_position_sigma": tiny, "kinematics_rotation_sigma": tiny}
        return KinematicMotion(replace(self.config, **sigmas))

    def between(self, before: RobotPosture, after: RobotPosture) -> MotionPrior:
        """The motion of the camera from one posture of the robot to another."""
        motion = invert_transform(before.T_odom_camera) @ after.T_odom_camera
        covariance = self._odometry_covariance(before, after) + self._kinematics_covariance(motion)
        return MotionPrior(motion, covariance)

    def since(self, before: RobotPosture, after: RobotPosture) -> MotionPrior:
        """As `between`; a robot that stands as it stood is where it was, as surely as then.

        Where neither arm nor base has moved, the kinematics err as they did before.
        """
        prior = self.between(before, after)
        return replace(prior, covariance=np.zeros((6, 6))) if prior.is_rest else prior

    def _odometry_covariance(self, before: RobotPosture, after: RobotPosture) -> FloatArray:
        """What the base's motion adds, in the old camera's frame, shape (6, 6)."""
        base_motion = invert_transform(before.T_odom_base) @ after.T_odom_base
        distance = float(np.linalg.norm(base_motion[:3, 3]))
        turned = float(Rotation.from_matrix(base_motion[:3, :3]).magnitude())
        lever = base_motion[:3, :3] @ after.T_base_camera[:3, 3]
        over = np.eye(6)
        over[:3, 3:] = -skew(lever)
        over = np.kron(np.eye(2), before.T_base_camera[:3, :3].T) @ over
        return np.asarray(over @ self.config.step_covariance(distance, turned) @ over.T)

    def _kinematics_covariance(self, motion: FloatArray) -> FloatArray:
        """What the kinematics add at the two ends, in the old camera's frame, shape (6, 6)."""
        end = self.config.kinematics_covariance()
        return np.asarray(end + carry_covariance(end, motion[:3, 3]))
