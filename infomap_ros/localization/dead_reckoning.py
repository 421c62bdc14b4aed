"""The camera's pose from odometry and kinematics alone: it drifts, and says how much.

The pose of the base where that of the camera is known, and the other way round.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from infomap_ros.errors import InvalidInputError
from infomap_ros.geometry import (
    OdometryRecord,
    PoseRecord,
    carry_covariance,
    check_transform,
    invert_transform,
)
from infomap_ros.geometry.config import check_config, parameter
from infomap_ros.geometry.transforms import FloatArray


@dataclass(frozen=True)
class DeadReckoningConfig:
    """How far odometry and kinematics are to be trusted.

    Raises:
        ConfigError: a value is out of its range.
    """

    position_per_meter: float = parameter(
        0.03,
        "Position sigma after one meter, where odometry comes without covariance.",
        unit="m",
        low=0.0,
        high=10.0,
    )
    position_per_radian: float = parameter(
        0.02,
        "Position sigma after turning by one radian, likewise: wheels that turn on the spot slip "
        "aside. A skid-steered rover on a slope needs more, such as 0.05.",
        unit="m",
        low=0.0,
        high=10.0,
    )
    rotation_per_meter: float = parameter(
        0.01, "Rotation sigma after one meter, likewise.", unit="rad", low=0.0, high=3.0
    )
    rotation_per_radian: float = parameter(
        0.02,
        "Rotation sigma after turning by one radian, likewise.",
        unit="rad",
        low=0.0,
        high=3.0,
    )
    kinematics_position_sigma: float = parameter(
        0.003,
        "Standard deviation of the camera's position on the robot, along each axis.",
        unit="m",
        low=1e-6,
        high=1.0,
    )
    kinematics_rotation_sigma: float = parameter(
        0.003,
        "Standard deviation of the camera's rotation on the robot, about each axis.",
        unit="rad",
        low=1e-6,
        high=1.0,
    )

    def __post_init__(self) -> None:
        check_config(self)

    def step_covariance(self, distance: float, turned: float) -> FloatArray:
        """What a step of odometry, [m] and [rad], adds to the pose's covariance, shape (6, 6)."""
        position = self.position_per_meter**2 * distance + self.position_per_radian**2 * turned
        rotation = self.rotation_per_meter**2 * distance + self.rotation_per_radian**2 * turned
        return np.diag([position] * 3 + [rotation] * 3)

    def kinematics_covariance(self) -> FloatArray:
        """How well the camera's pose on the robot is known, shape (6, 6)."""
        sigmas = [self.kinematics_position_sigma] * 3 + [self.kinematics_rotation_sigma] * 3
        return np.diag(np.square(sigmas))


class DeadReckoning:
    """Adds up what odometry and kinematics say.

    The covariance of odometry is taken over to the camera, which hangs on a lever, and that of the
    kinematics is added. Odometry without covariance (unknown, or all zero) gets one whose variances
    grow in proportion to the distance, as those of independent steps do.

    Args:
        config: how far they are to be trusted.
        T_map_odom: where odometry began, shape (4, 4); the map's origin where not given.
    """

    def __init__(
        self, config: DeadReckoningConfig | None = None, T_map_odom: FloatArray | None = None
    ) -> None:
        self.config = config or DeadReckoningConfig()
        self._T_map_odom = np.eye(4) if T_map_odom is None else check_transform(T_map_odom)
        self._last: FloatArray | None = None
        self._grown = np.zeros((6, 6))

    def add(self, odometry: OdometryRecord) -> PoseRecord:
        """Take odometry; returns the pose of the base in the map with its covariance.

        Args:
            odometry: ``T_odom_base``, in order of time.
        """
        pose = odometry.transform
        if self._last is not None:
            self._grow(self._last, pose)
        self._last = pose
        covariance = odometry.covariance
        if covariance is None or not np.any(covariance):
            covariance = self._grown
        turn = np.kron(np.eye(2), self._T_map_odom[:3, :3])
        return PoseRecord(
            odometry.stamp,
            "map",
            self._T_map_odom @ pose,
            turn @ covariance @ turn.T,
            odometry.child_frame_id,
        )

    def place(self, T_map_base: FloatArray) -> None:
        """The base of the last odometry is there in the map; its covariance stays.

        Args:
            T_map_base: shape (4, 4).

        Raises:
            InvalidInputError: there was no odometry yet, or that is no pose.
        """
        if self._last is None:
            raise InvalidInputError("T_map_base", "there was no odometry yet")
        placed = check_transform(T_map_base, "T_map_base")
        self._T_map_odom = placed @ invert_transform(self._last)

    def camera_pose(self, base: PoseRecord, T_base_camera: FloatArray, frame: str) -> PoseRecord:
        """Pose of the camera at the end of a kinematic chain.

        Args:
            base: pose of the base in the map, with covariance.
            T_base_camera: shape (4, 4).
            frame: name of the camera's frame.
        """
        lever = base.transform[:3, :3] @ T_base_camera[:3, 3]
        assert base.covariance is not None
        covariance = carry_covariance(base.covariance, lever) + self.config.kinematics_covariance()
        return PoseRecord(
            base.stamp, base.frame_id, base.transform @ T_base_camera, covariance, frame
        )

    def _grow(self, before: FloatArray, after: FloatArray) -> None:
        """What one step adds to the covariance; an earlier heading error swings the position."""
        step = after[:3, 3] - before[:3, 3]
        turned = float(Rotation.from_matrix(before[:3, :3].T @ after[:3, :3]).magnitude())
        added = self.config.step_covariance(float(np.linalg.norm(step)), turned)
        self._grown = carry_covariance(self._grown, step) + added


_UNKNOWN_TWIST = 1e6 * np.eye(6)  # [m^2/s^2, rad^2/s^2]: zero would be a velocity known exactly
_TILT = (2, 3, 4)  # z, roll and pitch among the rows of a pose's covariance


def base_in_map(
    camera: PoseRecord, T_base_camera: FloatArray, base_frame: str, config: DeadReckoningConfig
) -> OdometryRecord:
    """Where the base is whose camera is known; its twist is unknown.

    Args:
        camera: pose of the camera in the map.
        T_base_camera: shape (4, 4).
        base_frame: name of the base's frame.
        config: how well the camera's place on the base is known.
    """
    transform = camera.transform @ invert_transform(T_base_camera)
    covariance = None
    if camera.covariance is not None:
        covariance = carry_covariance(camera.covariance, transform[:3, 3] - camera.transform[:3, 3])
        covariance = covariance + config.kinematics_covariance()
    return OdometryRecord(
        camera.stamp,
        camera.frame_id,
        transform,
        covariance,
        base_frame,
        np.zeros(6),
        _UNKNOWN_TWIST,
    )


def user_base(given: PoseRecord, T_map_base: FloatArray) -> FloatArray:
    """The pose of the base that a user has given, shape (4, 4).

    Who points at a plan, as in RViz, gives x, y and heading: then the variances of z, roll and
    pitch are zero, and the base keeps them.

    Args:
        given: pose of the base in the map.
        T_map_base: where it was taken to be, shape (4, 4).
    """
    covariance = given.covariance
    if covariance is None or np.diag(covariance)[list(_TILT)].any():
        return given.transform
    turn = _heading(given.transform) - _heading(T_map_base)
    pose = T_map_base.copy()
    cosine, sine = np.cos(turn), np.sin(turn)
    pose[:3, :3] = [[cosine, -sine, 0.0], [sine, cosine, 0.0], [0.0, 0.0, 1.0]] @ pose[:3, :3]
    pose[:2, 3] = given.transform[:2, 3]
    return pose


def user_camera(base: PoseRecord, T_map_base: FloatArray, T_base_camera: FloatArray) -> PoseRecord:
    """Where the camera is when the base is where a user has said.

    Args:
        base: pose of the base in the map.
        T_map_base: where it was taken to be, shape (4, 4).
        T_base_camera: shape (4, 4).

    Raises:
        InvalidInputError: it has no covariance.
    """
    if base.covariance is None:
        raise InvalidInputError("initialpose", "has no covariance")
    T_map_given = user_base(base, T_map_base)
    lever = T_map_given[:3, :3] @ T_base_camera[:3, 3]
    covariance = carry_covariance(base.covariance, lever)
    return PoseRecord(base.stamp, base.frame_id, T_map_given @ T_base_camera, covariance)


def _heading(transform: FloatArray) -> float:
    return float(np.arctan2(transform[1, 0], transform[0, 0]))
