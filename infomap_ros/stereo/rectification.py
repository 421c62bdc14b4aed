"""Rectification: raw stereo images to rows that correspond."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from infomap_ros.errors import CalibrationError
from infomap_ros.geometry import (
    CameraCalibration,
    StereoRig,
    check_transform,
    rig_from_calibrations,
)
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.stereo.images import check_image, gray

_PINHOLE_MODELS = {"plumb_bob": (4, 5), "rational_polynomial": (8, 12, 14), "": (0, 4, 5)}
_FISHEYE = "equidistant"
_ROTATION_TOLERANCE = 1e-4


class StereoRectifier:
    """Rectifies a pair by the maps of its two calibrations.

    Attributes:
        rig: the rectified pair.
    """

    def __init__(self, left: CameraCalibration, right: CameraCalibration) -> None:
        """Compute the maps.

        Args:
            left: raw and rectified calibration of the left camera.
            right: the same of the right camera.

        Raises:
            CalibrationError: a distortion model is unknown or has a wrong number of
                coefficients, K or R is impossible, or the two do not make a rectified rig.
        """
        self.rig: StereoRig = rig_from_calibrations(left, right)
        self._maps = _maps(left, "left"), _maps(right, "right")

    def rectify(
        self, left: ArrayLike, right: ArrayLike, *, gray_right: bool = False
    ) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
        """Rectify a raw pair.

        Args:
            left: shape (H, W) or (H, W, 3), uint8.
            right: shape (H, W) or (H, W, 3), uint8.
            gray_right: the right image is wanted without its colors, which nothing in this
                package looks at; that is faster.

        Returns:
            Rectified left and right image; black where the raw image does not reach.

        Raises:
            InvalidInputError: an image is not uint8 with 1 or 3 channels.
            CalibrationError: an image does not have its calibration's size.
        """
        left_pixels = check_image(left, self.rig.left, "left image")
        right_pixels = check_image(right, self.rig.right, "right image")
        if gray_right:
            right_pixels = gray(right_pixels)
        return self._remap(left_pixels, 0), self._remap(right_pixels, 1)

    def _remap(self, pixels: NDArray[np.uint8], side: int) -> NDArray[np.uint8]:
        rectified = cv2.remap(pixels, *self._maps[side], cv2.INTER_LINEAR)
        return np.asarray(rectified, dtype=np.uint8)


def is_rectified(calibration: CameraCalibration) -> bool:
    """Tell whether the raw image of a camera is already its rectified image."""
    undistorted = not np.any(calibration.distortion)
    unturned = np.allclose(calibration.rectification, np.eye(3), atol=1e-9)
    same = np.allclose(calibration.intrinsics, calibration.projection[:, :3], atol=1e-6)
    return bool(undistorted and unturned and same)


def rectify_calibrations(
    left: CameraCalibration,
    right: CameraCalibration,
    T_right_left: ArrayLike,
    focal_length: float | None = None,
) -> tuple[CameraCalibration, CameraCalibration]:
    """Fill in R and P of a calibrated pair: both cameras turn to look across the baseline.

    After Fusiello, Trucco and Verri 2000, DOI 10.1007/s001380050120.

    Args:
        left: K and distortion of the left camera.
        right: K and distortion of the right camera, same image size.
        T_right_left: takes points in the left to points in the right camera frame, shape (4, 4)
            [m]; Kalibr calls it ``T_cn_cnm1`` of the right camera.
        focal_length: of the rectified images [px]; the mean of the raw ones where None. A fisheye
            pair needs a smaller one to keep its corners.

    Returns:
        Left and right calibration with R and P.

    Raises:
        InvalidInputError: T_right_left is not rigid.
        CalibrationError: no baseline, the right camera is not to the right, or the optical axes
            are more than 60 degrees off the common direction.
    """
    transform = check_transform(T_right_left, "T_right_left")
    turns, baseline = _common_orientation(transform)
    raw = (left.intrinsics[0, 0], left.intrinsics[1, 1])
    focal = float(focal_length or np.mean([raw, (right.intrinsics[0, 0], right.intrinsics[1, 1])]))
    center = ((left.width - 1) / 2.0, (left.height - 1) / 2.0)
    projection = np.array(
        [[focal, 0.0, center[0], 0.0], [0.0, focal, center[1], 0.0], [0.0, 0.0, 1.0, 0.0]]
    )
    shifted = projection.copy()
    shifted[0, 3] = -focal * baseline
    return (
        replace(left, rectification=turns[0], projection=projection),
        replace(right, rectification=turns[1], projection=shifted),
    )


def _common_orientation(
    T_right_left: FloatArray,
) -> tuple[tuple[FloatArray, FloatArray], float]:
    """Rotations left -> rectified and right -> rectified, and the baseline [m]."""
    rotation = T_right_left[:3, :3]
    center = -rotation.T @ T_right_left[:3, 3]  # right camera in the left frame
    baseline = float(np.linalg.norm(center))
    if baseline < 1e-6:
        raise CalibrationError("stereo extrinsics have no baseline")
    x_axis = center / baseline
    if x_axis[0] <= 0.5:
        raise CalibrationError(
            f"the right camera is at {center.round(4).tolist()} m of the left one, expected to "
            "its right (+x): are left and right swapped?"
        )
    forward = np.array([0.0, 0.0, 1.0]) + rotation.T[:, 2]  # mean of both optical axes
    y_axis = np.cross(forward, x_axis)
    y_axis /= np.linalg.norm(y_axis)
    left_turn = np.stack([x_axis, y_axis, np.cross(x_axis, y_axis)])
    if left_turn[2, 2] < 0.5 or (left_turn @ rotation.T)[2, 2] < 0.5:
        raise CalibrationError("the optical axes are more than 60 degrees off the common one")
    return (left_turn, left_turn @ rotation.T), baseline


def _maps(
    calibration: CameraCalibration, name: str
) -> tuple[NDArray[np.int16], NDArray[np.uint16]]:
    """Fixed-point maps from rectified to raw pixels."""
    _check_model(calibration, name)
    k, d = calibration.intrinsics, calibration.distortion
    r, p = calibration.rectification, calibration.projection[:, :3]
    size = (calibration.width, calibration.height)
    if calibration.distortion_model == _FISHEYE:
        maps = cv2.fisheye.initUndistortRectifyMap(k, d, r, p, size, cv2.CV_16SC2)
    else:
        maps = cv2.initUndistortRectifyMap(k, d, r, p, size, cv2.CV_16SC2)
    return np.asarray(maps[0], dtype=np.int16), np.asarray(maps[1], dtype=np.uint16)


def _check_model(calibration: CameraCalibration, name: str) -> None:
    model, count = calibration.distortion_model, calibration.distortion.size
    if model == _FISHEYE:
        allowed: tuple[int, ...] = (4,)
    elif model in _PINHOLE_MODELS:
        allowed = _PINHOLE_MODELS[model]
    else:
        known = ", ".join([*filter(None, _PINHOLE_MODELS), _FISHEYE])
        raise CalibrationError(f"{name} camera: distortion model '{model}', expected {known}")
    if count not in allowed and not (count == 0 and model != _FISHEYE):
        raise CalibrationError(
            f"{name} camera: {count} distortion coefficients, '{model}' has {allowed}"
        )
    focal = calibration.intrinsics[0, 0], calibration.intrinsics[1, 1]
    if min(focal) <= 0.0:
        raise CalibrationError(f"{name} camera: focal lengths {focal} of K are not positive")
    r = calibration.rectification
    if not np.allclose(r @ r.T, np.eye(3), atol=_ROTATION_TOLERANCE) or np.linalg.det(r) < 0.0:
        raise CalibrationError(f"{name} camera: R is not a rotation")
