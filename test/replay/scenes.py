"""Bags of a wall, made without a renderer, and where the wall is."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from infomap_ros.errors import CapacityError
from infomap_ros.geometry import (
    CameraCalibration,
    CameraInfoRecord,
    ImageRecord,
    PinholeCamera,
    PoseRecord,
    Record,
    StereoRig,
    make_transform,
)
from infomap_ros.mapping import VoxelMap
from infomap_ros.replay.bags.writer import BagWriter

WALL = 2.0
"""The wall is the plane x = WALL of the map; the camera looks along x [m]."""

STEP = 100_000_000
START = 1_000_000_000
CAMERA = PinholeCamera(160, 120, 120.0, 120.0, 79.5, 59.5)
COVARIANCE = np.diag([1e-6] * 3 + [1e-8] * 3)


def pose_at(x: float, y: float = 0.0) -> np.ndarray:
    """T_map_camera of an optical frame that looks along x."""
    return make_transform([[0, 0, 1], [-1, 0, 0], [0, -1, 0]], [x, y, 0.0])


def pinhole_calibration(camera: PinholeCamera, baseline: float = 0.0) -> CameraCalibration:
    """The camera info of a rectified camera at `baseline` [m] to the right of the left one."""
    projection = np.zeros((3, 4))
    projection[:, :3] = camera.matrix
    projection[0, 3] = -camera.fx * baseline
    return CameraCalibration(
        camera.width,
        camera.height,
        "plumb_bob",
        np.zeros(5),
        camera.matrix,
        projection=projection,
    )


def rectified_pair(stamp: int, rig: StereoRig, left: np.ndarray, right: np.ndarray):
    """Messages of one rectified pair."""
    for side, pixels, camera, baseline in (
        ("left", left, rig.left, 0.0),
        ("right", right, rig.right, rig.baseline),
    ):
        frame, calibration = f"{side}_optical_frame", pinhole_calibration(camera, baseline)
        yield f"/{side}/camera_info", CameraInfoRecord(stamp, frame, calibration)
        encoding = "mono8" if pixels.ndim == 2 else "bgr8"
        yield f"/{side}/image_rect", ImageRecord(stamp, frame, pixels, encoding)


def depth_frames(count: int = 6, covariance: np.ndarray | None = COVARIANCE):
    """A depth camera that comes nearer, 0.1 m a frame; poses between the images too."""
    for index in range(count):
        stamp, x = START + index * STEP, 0.1 * index
        yield "/camera_pose", PoseRecord(stamp, "map", pose_at(x), covariance)
        info = CameraInfoRecord(stamp, "optical", pinhole_calibration(CAMERA))
        yield "/depth/camera_info", info
        depth = np.full((CAMERA.height, CAMERA.width), round(1000 * (WALL - x)), np.uint16)
        yield "/depth/image_rect", ImageRecord(stamp, "optical", depth, "16UC1")


def stereo_frames(count: int = 3, scale: float = 1.0):
    """A textured wall before a rectified pair; the right image is the left one shifted.

    The baseline and the wall's distance are `scale` times the usual ones.
    """
    camera = PinholeCamera(320, 240, 240.0, 240.0, 159.5, 119.5)
    rig = StereoRig(camera, camera, 0.1 * scale)
    noise = np.random.default_rng(3).integers(0, 255, (240, 420), dtype=np.uint8)
    texture = cv2.GaussianBlur(noise, (0, 0), 1.2)
    texture = cv2.normalize(texture, None, 0, 255, cv2.NORM_MINMAX)
    for index in range(count):
        stamp = START + index * STEP
        shift = float(rig.disparity_from_depth(WALL * scale))  # a whole number: 12 px
        left = texture[:, 40 : 40 + 320]
        right = texture[:, 40 + round(shift) : 40 + round(shift) + 320]
        yield "/camera_pose", PoseRecord(stamp, "map", pose_at(0.0), COVARIANCE)
        yield from rectified_pair(stamp, rig, left.copy(), right.copy())


def write(path: Path, entries: object) -> Path:
    """Write entries as a bag."""
    with BagWriter(path) as writer:
        topic: str
        record: Record
        for topic, record in entries:  # type: ignore[attr-defined]
            writer.write(topic, record)
    return path


def fill_after(monkeypatch: pytest.MonkeyPatch, frames: int) -> None:
    """Let maps have no room after some frames."""
    integrate, taken = VoxelMap.integrate, []

    def limited(self: VoxelMap, *arguments: object, **named: object) -> object:
        if len(taken) == frames:
            raise CapacityError("no room")
        taken.append(1)
        return integrate(self, *arguments, **named)  # type: ignore[arg-type]

    monkeypatch.setattr(VoxelMap, "integrate", limited)
