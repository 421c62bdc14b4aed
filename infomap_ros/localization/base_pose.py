"""The pose of the base where that of the camera is known, and the other way round."""

from __future__ import annotations

import numpy as np

from infomap_ros.errors import InvalidInputError
from infomap_ros.geometry import (
    OdometryRecord,
    PoseRecord,
    carry_covariance,
    invert_transform,
)
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.localization.dead_reckoning import DeadReckoningConfig

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


def told_base(told: PoseRecord, T_map_base: FloatArray) -> FloatArray:
    """The pose of the base that a user has told, shape (4, 4).

    Who points at a plan, as in RViz, tells x, y and heading: then the variances of z, roll and
    pitch are zero, and the base keeps them.

    Args:
        told: pose of the base in the map.
        T_map_base: where it was taken to be, shape (4, 4).
    """
    covariance = told.covariance
    if covariance is None or np.diag(covariance)[list(_TILT)].any():
        return told.transform
    turn = _heading(told.transform) - _heading(T_map_base)
    pose = T_map_base.copy()
    cosine, sine = np.cos(turn), np.sin(turn)
    pose[:3, :3] = [[cosine, -sine, 0.0], [sine, cosine, 0.0], [0.0, 0.0, 1.0]] @ pose[:3, :3]
    pose[:2, 3] = told.transform[:2, 3]
    return pose


def told_camera(told: PoseRecord, T_map_base: FloatArray, T_base_camera: FloatArray) -> PoseRecord:
    """Where the camera is when the base is where a user has told.

    Args:
        told: pose of the base in the map.
        T_map_base: where it was taken to be, shape (4, 4).
        T_base_camera: shape (4, 4).

    Raises:
        InvalidInputError: it is told without a covariance.
    """
    if told.covariance is None:
        raise InvalidInputError("initialpose", "has no covariance")
    base = told_base(told, T_map_base)
    lever = base[:3, :3] @ T_base_camera[:3, 3]
    covariance = carry_covariance(told.covariance, lever)
    return PoseRecord(told.stamp, told.frame_id, base @ T_base_camera, covariance)


def _heading(transform: FloatArray) -> float:
    return float(np.arctan2(transform[1, 0], transform[0, 0]))
