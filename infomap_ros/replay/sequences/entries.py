"""What the converters share: topics, images from files, cameras."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from infomap_ros.errors import BagError
from infomap_ros.geometry import (
    CameraCalibration,
    CameraInfoRecord,
    ImageRecord,
    PinholeCamera,
    Record,
    StereoRig,
)

Entry = tuple[str, Record]
"""Topic and record."""

Entries = Iterator[Entry]

LEFT_FRAME, RIGHT_FRAME = "left_optical_frame", "right_optical_frame"
FIRST_STAMP = 1_000_000_000
"""Stamp of the first frame of a sequence that has no times [ns]."""


def read_image(path: Path) -> NDArray[np.generic]:
    """Read an image file as it is; three channels are in the order B, G, R.

    Raises:
        BagError: there is no such file or it is not an image.
    """
    pixels = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    if pixels is None:
        raise BagError(f"{path} is not there or not an image")
    return pixels


def read_text_table(path: Path, **arguments: object) -> NDArray[np.float64]:
    """Read a table of numbers by `numpy.loadtxt`.

    Raises:
        BagError: there is no such file or it holds something else.
    """
    try:
        return np.loadtxt(path, **arguments)  # type: ignore[call-overload]
    except (OSError, ValueError) as error:
        raise BagError(f"{path} cannot be read: {error}") from error


def image_record(stamp: int, frame_id: str, pixels: NDArray[np.generic]) -> ImageRecord:
    """An image with the encoding that its type and channels have in files."""
    wide = pixels.dtype == np.uint16
    encoding = {2: "mono16" if wide else "mono8", 3: "bgr16" if wide else "bgr8"}[pixels.ndim]
    return ImageRecord(stamp, frame_id, pixels, encoding)


def pinhole_calibration(camera: PinholeCamera, baseline: float = 0.0) -> CameraCalibration:
    """The camera info of a rectified camera at `baseline` [m] to the right of the left one."""
    projection = np.zeros((3, 4))
    projection[:, :3] = camera.matrix
    projection[0, 3] = -camera.fx * baseline
    return CameraCalibration(
        width=camera.width,
        height=camera.height,
        distortion_model="plumb_bob",
        distortion=np.zeros(5),
        intrinsics=camera.matrix,
        projection=projection,
    )


def rectified_pair(
    stamp: int, rig: StereoRig, left: NDArray[np.generic], right: NDArray[np.generic]
) -> Entries:
    """Messages of one rectified pair."""
    for side, frame, pixels, camera, baseline in (
        ("left", LEFT_FRAME, left, rig.left, 0.0),
        ("right", RIGHT_FRAME, right, rig.right, rig.baseline),
    ):
        calibration = pinhole_calibration(camera, baseline)
        yield f"/{side}/camera_info", CameraInfoRecord(stamp, frame, calibration)
        yield f"/{side}/image_rect", image_record(stamp, frame, pixels)
