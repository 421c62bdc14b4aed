"""Pinhole cameras, rectified stereo rigs, and the calibration of a raw camera.

Camera coordinates are optical: x right, y down, z forward [m]. Pixel coordinates are (u, v) with
the center of the top left pixel at (0, 0).
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray

from infomap_ros.errors import CalibrationError
from infomap_ros.geometry.transforms import FloatArray

_WIDEST = 150.0  # field of view of a rectified image; more tells of another unit or size [deg]
_MOST_SKEW = 1e-3  # of a rectified image, as a share of its focal length
LONGEST_BASELINE = 5.0
"""Of a pair on a robot or car; more means another unit than meters [m]."""


@dataclass(frozen=True)
class PinholeCamera:
    """An undistorted (rectified) camera.

    Attributes:
        width: image width [px].
        height: image height [px].
        fx: focal length along u [px].
        fy: focal length along v [px].
        cx: principal point, u [px].
        cy: principal point, v [px].

    Raises:
        CalibrationError: a size or focal length is not positive, or a value is not finite.
    """

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float

    def __post_init__(self) -> None:
        numbers = (self.fx, self.fy, self.cx, self.cy)
        if not np.isfinite(numbers).all():
            raise CalibrationError(f"camera intrinsics (fx, fy, cx, cy) = {numbers} are not finite")
        if self.width <= 0 or self.height <= 0:
            raise CalibrationError(f"camera image size {self.width}x{self.height} is not positive")
        if self.fx <= 0.0 or self.fy <= 0.0:
            raise CalibrationError(
                f"camera focal lengths fx={self.fx}, fy={self.fy} are not positive"
            )

    @property
    def matrix(self) -> FloatArray:
        """Intrinsic matrix K, shape (3, 3) [px]."""
        return np.array([[self.fx, 0.0, self.cx], [0.0, self.fy, self.cy], [0.0, 0.0, 1.0]])

    @property
    def field_of_view(self) -> tuple[float, float]:
        """Full horizontal and vertical opening angle [rad]."""
        left, right = (self.cx + 0.5) / self.fx, (self.width - 0.5 - self.cx) / self.fx
        top, bottom = (self.cy + 0.5) / self.fy, (self.height - 0.5 - self.cy) / self.fy
        horizontal = np.arctan(left) + np.arctan(right)
        vertical = np.arctan(top) + np.arctan(bottom)
        return float(horizontal), float(vertical)

    def project(self, points: ArrayLike) -> FloatArray:
        """Project points in the camera frame.

        Args:
            points: shape (..., 3) [m].

        Returns:
            Pixels (u, v), shape (..., 2); NaN for points that are not in front of the camera.
        """
        coordinates = np.asarray(points, dtype=np.float64)
        depth = np.where(coordinates[..., 2] > 0.0, coordinates[..., 2], np.nan)
        u = self.fx * coordinates[..., 0] / depth + self.cx
        v = self.fy * coordinates[..., 1] / depth + self.cy
        return np.stack([u, v], axis=-1)

    def back_project(self, depth: ArrayLike) -> NDArray[np.float32]:
        """Turn a depth image into organized points in the camera frame.

        Args:
            depth: z of every pixel, shape (height, width) [m]; NaN where not measured.

        Returns:
            Points, shape (height, width, 3), float32 [m]; NaN where depth is.

        Raises:
            CalibrationError: the depth image does not have this camera's size.
        """
        z = np.asarray(depth, dtype=np.float32)
        if z.shape != (self.height, self.width):
            raise CalibrationError(
                f"depth image of shape {z.shape} does not fit the calibration for "
                f"{self.width}x{self.height} px, shape {(self.height, self.width)}"
            )
        x_per_z = ((np.arange(self.width) - self.cx) / self.fx).astype(np.float32)
        y_per_z = ((np.arange(self.height) - self.cy) / self.fy).astype(np.float32)
        return np.stack([z * x_per_z, z * y_per_z[:, None], z], axis=-1)

    def scaled(self, factor: float) -> PinholeCamera:
        """The same camera with an image resized by `factor` in both directions."""
        return PinholeCamera(
            width=max(1, round(self.width * factor)),
            height=max(1, round(self.height * factor)),
            fx=self.fx * factor,
            fy=self.fy * factor,
            cx=(self.cx + 0.5) * factor - 0.5,
            cy=(self.cy + 0.5) * factor - 0.5,
        )


@dataclass(frozen=True)
class StereoRig:
    """A rectified stereo pair: rows are aligned, the right camera sits at +x of the left.

    Attributes:
        left: left camera.
        right: right camera; shares fx, fy and cy with the left.
        baseline: distance between the two optical centers [m].

    Raises:
        CalibrationError: the baseline is not positive, or the cameras are not rectified to
            each other.
    """

    left: PinholeCamera
    right: PinholeCamera
    baseline: float

    def __post_init__(self) -> None:
        if not (np.isfinite(self.baseline) and self.baseline > 0.0):
            raise CalibrationError(f"stereo baseline {self.baseline} m is not positive")
        for name in ("width", "height", "fx", "fy", "cy"):
            left, right = getattr(self.left, name), getattr(self.right, name)
            if not np.isclose(left, right, rtol=1e-6, atol=1e-6):
                raise CalibrationError(
                    f"stereo cameras are not rectified to each other: {name} is "
                    f"{left} on the left and {right} on the right"
                )

    @property
    def principal_offset(self) -> float:
        """``right.cx - left.cx`` [px]: what a disparity of zero is short of infinity's."""
        return self.right.cx - self.left.cx

    def depth_from_disparity(self, disparity: ArrayLike) -> FloatArray:
        """Depth z = fx * baseline / (d + principal_offset) [m]; NaN where that is not positive.

        Args:
            disparity: ``u_left - u_right``, any shape [px]; NaN or infinite = no measurement.
        """
        shifted = np.asarray(disparity, dtype=np.float64) + self.principal_offset
        measured = (shifted > 0.0) & (shifted < np.inf)
        return self.left.fx * self.baseline / np.where(measured, shifted, np.nan)

    def disparity_from_depth(self, depth: ArrayLike) -> FloatArray:
        """Inverse of `depth_from_disparity`: disparity [px] for depth [m], any shape.

        NaN where depth is not positive.
        """
        z = np.asarray(depth, dtype=np.float64)
        return self.left.fx * self.baseline / np.where(z > 0.0, z, np.nan) - self.principal_offset


@dataclass(frozen=True, eq=False)
class CameraCalibration:
    """What ``sensor_msgs/CameraInfo`` says of a camera, raw and rectified.

    Attributes:
        width: image width [px].
        height: image height [px].
        distortion_model: ``plumb_bob``, ``rational_polynomial``, ``equidistant`` or empty.
        distortion: D, shape (n,), as the model orders it.
        intrinsics: K of the raw image, shape (3, 3) [px].
        rectification: R, rotation from the raw to the rectified camera frame, shape (3, 3).
        projection: P of the rectified image, shape (3, 4) [px]; for a right camera
            ``P[0, 3] = -fx * baseline``. All zero where the camera is not calibrated.

    Raises:
        CalibrationError: a matrix has the wrong number of elements or is not finite.
    """

    width: int
    height: int
    distortion_model: str = ""
    distortion: FloatArray = field(default_factory=lambda: np.zeros(0))
    intrinsics: FloatArray = field(default_factory=lambda: np.eye(3))
    rectification: FloatArray = field(default_factory=lambda: np.eye(3))
    projection: FloatArray = field(default_factory=lambda: np.zeros((3, 4)))

    def __post_init__(self) -> None:
        shapes = {"intrinsics": (3, 3), "rectification": (3, 3), "projection": (3, 4)}
        for name, shape in shapes.items():
            matrix = np.array(getattr(self, name), dtype=np.float64)
            if matrix.size != shape[0] * shape[1]:
                raise CalibrationError(
                    f"camera calibration: {name} has shape {matrix.shape}, expected {shape}"
                )
            matrix = matrix.reshape(shape)
            if not np.isfinite(matrix).all():
                raise CalibrationError(f"camera calibration: {name} holds NaN or infinity")
            object.__setattr__(self, name, matrix)
        object.__setattr__(self, "distortion", np.array(self.distortion, dtype=np.float64))
        if not np.isfinite(self.distortion).all():
            raise CalibrationError("camera calibration: distortion holds NaN or infinity")

    def rectified_camera(self) -> PinholeCamera:
        """The pinhole camera of the rectified image (from P).

        Raises:
            CalibrationError: P is not calibrated, impossible or not plausible; says its value.
        """
        p = self.projection
        if p[0, 0] == 0.0:
            raise CalibrationError("camera is not calibrated: the projection matrix P is zero")
        camera = PinholeCamera(self.width, self.height, p[0, 0], p[1, 1], p[0, 2], p[1, 2])
        widest = 0.5 * max(self.width / camera.fx, self.height / camera.fy)
        if (angle := np.degrees(2.0 * np.arctan(widest))) > _WIDEST:
            focal = f"fx = {camera.fx:.6g}, fy = {camera.fy:.6g} px"
            raise CalibrationError(f"{focal}: {angle:.1f} deg of view; are they in px?")
        if abs(p[0, 1]) > _MOST_SKEW * camera.fx:
            raise CalibrationError(f"skew P[0, 1] is {p[0, 1]:.6g} px; rectified images have none")
        return camera

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, CameraCalibration):
            return NotImplemented
        return (
            (self.width, self.height, self.distortion_model)
            == (other.width, other.height, other.distortion_model)
            and np.array_equal(self.distortion, other.distortion)
            and np.array_equal(self.intrinsics, other.intrinsics)
            and np.array_equal(self.rectification, other.rectification)
            and np.array_equal(self.projection, other.projection)
        )

    def __hash__(self) -> int:
        return hash((self.width, self.height, self.projection.tobytes()))


def rig_from_calibrations(left: CameraCalibration, right: CameraCalibration) -> StereoRig:
    """Build the rectified rig from the two camera infos (baseline from the right P).

    Raises:
        CalibrationError: sizes differ, a camera is not calibrated, the baseline is zero, negative
            (cameras swapped) or longer than `LONGEST_BASELINE` (not in meters), or the rectified
            cameras do not fit each other.
    """
    if (left.width, left.height) != (right.width, right.height):
        raise CalibrationError(
            f"left camera info is for {left.width}x{left.height} px, "
            f"right for {right.width}x{right.height} px"
        )
    right_camera = right.rectified_camera()
    baseline = (left.projection[0, 3] - right.projection[0, 3]) / right_camera.fx
    if not 0.0 < baseline < LONGEST_BASELINE:
        raise CalibrationError(
            f"stereo baseline from the camera infos is {baseline:.6g} m, with P[0, 3] = "
            f"{left.projection[0, 3]:.6g} on the left camera and {right.projection[0, 3]:.6g} on "
            "the right one, where it must be -fx * baseline (are left and right swapped, or is it "
            "not in meters?)"
        )
    return StereoRig(left.rectified_camera(), right_camera, float(baseline))
