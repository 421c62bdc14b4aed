"""How much localization suffers on the way to a view."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from infomap_ros.geometry.config import check_config, parameter
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.views.situation import Situation

LocalizationError = Callable[[Situation, FloatArray, FloatArray], FloatArray]
"""Error accumulated on the way to views: situation, poses (M, 4, 4), lengths of the ways (M,) [m]
-> growth of the position sigma (M,) [m]."""


@dataclass(frozen=True)
class OdometryDriftConfig:
    """How fast the pose becomes uncertain when nothing but odometry tells of motion.

    The variances grow in proportion to the way, as those of independent steps do.

    Raises:
        ConfigError: a value is out of its range.
    """

    position_per_meter: float = parameter(
        0.03, "Position sigma after one meter.", unit="m", low=0.0, high=10.0
    )
    position_per_radian: float = parameter(
        0.005, "Position sigma after turning by one radian.", unit="m", low=0.0, high=10.0
    )
    rotation_per_meter: float = parameter(
        0.01, "Rotation sigma after one meter.", unit="rad", low=0.0, high=3.0
    )
    rotation_per_radian: float = parameter(
        0.02, "Rotation sigma after turning by one radian.", unit="rad", low=0.0, high=3.0
    )

    def __post_init__(self) -> None:
        check_config(self)


class OdometryDrift:
    """Localization error LE of eq. (11), until landmarks on the way can be predicted.

    The pose covariance at the end of the way is the present one, turned into the position error
    that a heading error causes over the way, plus what odometry adds.
    """

    def __init__(self, config: OdometryDriftConfig | None = None) -> None:
        self.config = config or OdometryDriftConfig()

    def __call__(self, situation: Situation, poses: FloatArray, lengths: FloatArray) -> FloatArray:
        """Error of the views, shape (M,) [m].

        Args:
            situation: pose and covariance now.
            poses: ``T_map_camera``, shape (M, 4, 4).
            lengths: of the ways there, shape (M,) [m].
        """
        before = float(np.trace(situation.pose_covariance[:3, :3]))
        turns = rotation_angles(situation.T_map_camera, poses)
        config = self.config
        position = config.position_per_meter**2 * lengths + config.position_per_radian**2 * turns
        added = config.rotation_per_meter**2 * lengths + config.rotation_per_radian**2 * turns
        # A heading error moves the end of a way of length s by s; one that grows on the way in
        # proportion to it, by s / sqrt(3).
        heading = situation.pose_covariance[5, 5]
        position = position + lengths**2 * (heading + added / 3.0)
        return np.asarray(np.sqrt(before + position) - np.sqrt(before))


def rotation_vectors(T_map_camera: FloatArray, poses: FloatArray) -> FloatArray:
    """Rotations from one pose to others, about the axes of the map, (M, 4, 4) -> (M, 3) [rad]."""
    turns = poses[:, :3, :3] @ T_map_camera[:3, :3].T
    return np.asarray(Rotation.from_matrix(turns).as_rotvec()).reshape(-1, 3)


def rotation_angles(T_map_camera: FloatArray, poses: FloatArray) -> FloatArray:
    """Angles of these rotations, (M, 4, 4) -> (M,) [rad]."""
    return np.asarray(np.linalg.norm(rotation_vectors(T_map_camera, poses), axis=1))
