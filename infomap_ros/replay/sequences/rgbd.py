"""Folders of RGB-D frames with a pose each: colour, depth in mm, camera-to-world matrix."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from infomap_ros.errors import BagError, InvalidInputError
from infomap_ros.geometry import (
    CameraInfoRecord,
    ImageRecord,
    PinholeCamera,
    PoseRecord,
    check_transform,
)
from infomap_ros.replay.sequences.entries import (
    FIRST_STAMP,
    Entries,
    image_record,
    pinhole_calibration,
    read_image,
    read_text_table,
)

_FRAME = "camera_optical_frame"
_PERIOD = 1e9 / 30.0  # recorded at 30 Hz; the file names count the frames of the recording [ns]


def rgbd_frames(folder: Path) -> Entries:
    """Read ``frames/frame-NNNNNN.{color.jpg,depth.png,pose.txt}`` and ``camera-intrinsics.txt``.

    Frames whose pose is not a rigid transform (lost tracking) are left out.

    Raises:
        BagError: a file is missing or holds something else.
    """
    intrinsics = read_text_table(folder / "camera-intrinsics.txt")
    pose_files = sorted((folder / "frames").glob("frame-*.pose.txt"))
    if not pose_files:
        raise BagError(f"{folder} has no frames/frame-*.pose.txt")
    for pose_file in pose_files:
        name = pose_file.name.removesuffix(".pose.txt")
        stamp = FIRST_STAMP + round(int(name.rpartition("-")[2]) * _PERIOD)
        yield from _frame(folder / "frames" / name, stamp, intrinsics, pose_file)


def _frame(stem: Path, stamp: int, intrinsics: np.ndarray, pose_file: Path) -> Entries:
    depth = read_image(stem.with_name(f"{stem.name}.depth.png"))
    color = read_image(stem.with_name(f"{stem.name}.color.jpg"))
    try:
        pose = check_transform(_orthonormal(read_text_table(pose_file)), pose_file.name)
    except InvalidInputError:
        return
    height, width = depth.shape
    camera = PinholeCamera(
        width, height, intrinsics[0, 0], intrinsics[1, 1], intrinsics[0, 2], intrinsics[1, 2]
    )
    info = CameraInfoRecord(stamp, _FRAME, pinhole_calibration(camera))
    yield "/depth/camera_info", info
    yield "/rgb/camera_info", info
    yield "/camera_pose", PoseRecord(stamp, "map", pose)
    yield "/rgb/image_rect", image_record(stamp, _FRAME, color)
    yield "/depth/image_rect", ImageRecord(stamp, _FRAME, depth.astype(np.uint16), "16UC1")


def _orthonormal(matrix: np.ndarray) -> np.ndarray:
    """The transform with its rotation, rounded in the file, made exact."""
    pose = np.array(matrix, dtype=np.float64)
    if np.isfinite(pose).all() and pose.shape == (4, 4):
        left, _, right = np.linalg.svd(pose[:3, :3])
        nearest = left @ right
        if np.allclose(nearest, pose[:3, :3], atol=1e-3):
            pose[:3, :3] = nearest
    return pose
