"""Data with its stamp and frame: what a live topic and a bag both become.

Stamps are integer nanoseconds since the epoch of the source's clock. A record is immutable; its
arrays must not be written to.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from infomap_ros.geometry.camera import CameraCalibration
from infomap_ros.geometry.pose_uncertainty import PoseUncertainty
from infomap_ros.geometry.transforms import FloatArray


@dataclass(frozen=True, eq=False)
class Record:
    """Common part of all records.

    Attributes:
        stamp: time of measurement [ns].
        frame_id: frame in which the data are expressed.
    """

    stamp: int
    frame_id: str


@dataclass(frozen=True, eq=False)
class ImageRecord(Record):
    """An image.

    Attributes:
        pixels: shape (H, W) or (H, W, channels); dtype as the encoding says.
        encoding: as in ``sensor_msgs/image_encodings``, for example ``mono8``, ``rgb8``,
            ``32FC1`` (depth in m), ``16UC1`` (depth in mm).
    """

    pixels: NDArray[np.generic]
    encoding: str


@dataclass(frozen=True, eq=False)
class CameraInfoRecord(Record):
    """A camera's calibration."""

    calibration: CameraCalibration


@dataclass(frozen=True, eq=False)
class PoseRecord(Record):
    """Pose of a child frame in `frame_id`.

    Attributes:
        transform: ``T_frame_child``, shape (4, 4).
        covariance: shape (6, 6), order and convention of `geometry.transforms`; None if unknown
            (never zero for unknown).
        child_frame_id: empty where the message does not say.
        uncertainty: the covariance in its parts, None where nobody says.
    """

    transform: FloatArray
    covariance: FloatArray | None = None
    child_frame_id: str = ""
    uncertainty: PoseUncertainty | None = field(default=None, kw_only=True)


@dataclass(frozen=True, eq=False)
class OdometryRecord(PoseRecord):
    """Odometry: a pose and the velocity of the child frame.

    Attributes:
        twist: linear [m/s] and angular [rad/s] velocity in the child frame, shape (6,).
        twist_covariance: shape (6, 6) or None if unknown.
    """

    twist: FloatArray | None = None
    twist_covariance: FloatArray | None = None


@dataclass(frozen=True, eq=False)
class JointStateRecord(Record):
    """Joint positions.

    Attributes:
        names: n joint names.
        positions: shape (n,) [rad or m].
        velocities: shape (n,) [rad/s or m/s], or None where the message has none.
    """

    names: tuple[str, ...]
    positions: FloatArray
    velocities: FloatArray | None = None


@dataclass(frozen=True, eq=False)
class TransformRecord(Record):
    """One edge of the tf tree: ``T_frame_child``.

    Attributes:
        child_frame_id: the child.
        transform: shape (4, 4).
        is_static: from /tf_static.
    """

    child_frame_id: str
    transform: FloatArray
    is_static: bool = False


@dataclass(frozen=True, eq=False)
class PointCloudRecord(Record):
    """Range points.

    Attributes:
        points: shape (H, W, 3) when organized, else (N, 3), float32 [m]; NaN = no measurement.
        covariances: shape (..., 3, 3) like points, or (..., 6) as (xx, xy, xz, yy, yz, zz), float32
            [m^2]; None if unknown.
        colors: shape (..., 3), uint8 RGB, or None.
        error_correlation: mean correlation of the errors of two points of one surface patch, 0 to
            1; None if unknown.
    """

    points: NDArray[np.float32]
    covariances: NDArray[np.float32] | None = None
    colors: NDArray[np.uint8] | None = None
    error_correlation: float | None = None


@dataclass(frozen=True, eq=False)
class TextRecord(Record):
    """A string, for example a robot description."""

    text: str
