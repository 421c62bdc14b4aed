"""A depth camera with a color image that goes through a textured room, as a bag."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from infomap_ros.geometry import (
    CameraInfoRecord,
    ImageRecord,
    OdometryRecord,
    PinholeCamera,
    Record,
    TransformRecord,
    invert_transform,
    make_transform,
)
from infomap_ros.geometry.records import ImuRecord
from infomap_ros.replay.bags.writer import BagWriter

from .scenes import pinhole_calibration

CAMERA = PinholeCamera(240, 180, 200.0, 200.0, 119.5, 89.5)
START, STEP = 1_000_000_000, 100_000_000
WALL = 2.0  # x of the wall that the camera looks at [m]
OPTICAL = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
T_BASE_CAMERA = make_transform(OPTICAL, [0.1, 0.0, 0.2])


IMU_STEP = 5_000_000
R_OPTICAL_IMU = Rotation.from_euler("xyz", [0.5, 1.0, -2.0]).as_matrix()
TILT = Rotation.from_euler("xyz", [0.05, 0.2, 0.0]).as_matrix()
"""By which the wall is out of plumb."""


def pose(index: int) -> np.ndarray:
    """T_map_camera: level, along x and y, z of the camera as on the base."""
    return make_transform(OPTICAL, [0.1 + 0.02 * index, -0.015 * index, 0.2])


def image_of(T_map_camera: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Brightness, shape (H, W), uint8, and depth, uint16 [mm]: a wall with a step in it."""
    v, u = np.mgrid[0 : CAMERA.height, 0 : CAMERA.width]
    rays = np.stack([(u - CAMERA.cx) / CAMERA.fx, (v - CAMERA.cy) / CAMERA.fy], axis=-1)
    place = T_map_camera[:3, 3]
    depth = np.full(u.shape, WALL - place[0])
    nearer = depth - 0.5
    depth = np.where(place[1] - rays[..., 0] * nearer > 0.1, nearer, depth)
    across = place[1] - rays[..., 0] * depth
    up = place[2] - rays[..., 1] * depth
    columns, rows = 500.0 + 150.0 * across, 500.0 - 150.0 * up
    texture = _texture()
    image = cv2.remap(
        texture, columns.astype(np.float32), rows.astype(np.float32), cv2.INTER_LINEAR
    )
    return image.astype(np.uint8), np.rint(1000.0 * depth).astype(np.uint16)


def _texture() -> np.ndarray:
    rng = np.random.default_rng(8)
    total = sum(
        cv2.GaussianBlur(rng.standard_normal((1000, 1000)), (0, 0), size) * size
        for size in (1.5, 4.0, 12.0)
    )
    return np.clip(120.0 + 50.0 * total / np.std(total), 0, 255).astype(np.float32)


def entries(
    count: int = 10, *, odometry: bool = False, color: bool = True, imu: str = ""
) -> Iterator[tuple[str, Record]]:
    """Topics and records; `imu` is the frame of an inertial sensor, turned to the camera."""
    if imu:
        T_optical_imu = make_transform(R_OPTICAL_IMU, np.zeros(3))
        yield "/tf_static", TransformRecord(START, "optical", "imu", T_optical_imu, True)
        for stamp in range(START - 20 * IMU_STEP, START + count * STEP, IMU_STEP):
            force = R_OPTICAL_IMU.T @ OPTICAL.T @ TILT.T @ [0.0, 0.0, 9.81]
            yield "/imu/data", ImuRecord(stamp, imu, np.zeros(3), force)
    if odometry:
        yield "/tf_static", TransformRecord(START, "base_link", "optical", T_BASE_CAMERA, True)
    for index in range(count):
        stamp = START + index * STEP
        image, depth = image_of(pose(index))
        if odometry:
            T_odom_base = pose(index) @ invert_transform(T_BASE_CAMERA)
            yield "/odom", OdometryRecord(stamp, "odom", T_odom_base, None, "base_link")
        info = CameraInfoRecord(stamp, "optical", pinhole_calibration(CAMERA))
        yield "/depth_registered/camera_info", info
        if color:
            yield "/rgb/image_rect_color", ImageRecord(stamp, "optical", image, "mono8")
        yield "/depth_registered/image_rect", ImageRecord(stamp, "optical", depth, "16UC1")


def write(path: Path, **options: object) -> Path:
    """Write them as a bag."""
    with BagWriter(path) as writer:
        for topic, record in entries(**options):  # type: ignore[arg-type]
            if isinstance(record, TransformRecord):
                writer.write_transforms(topic, [record])
            else:
                writer.write(topic, record)
    return path
