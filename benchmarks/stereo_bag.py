"""A stereo bag of the benchmark room: 640x480 pairs at 10 Hz, ray cast with a procedural texture.

The room is that of `room.py`. The left camera moves along a circle; poses carry a small covariance.
"""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import room

from infomap_ros.geometry import (
    CameraCalibration,
    CameraInfoRecord,
    ImageRecord,
    PoseRecord,
    make_transform,
)
from infomap_ros.replay.bags.writer import BagWriter

BASELINE = 0.1  # [m]
PERIOD = 100_000_000  # [ns]
START = 1_700_000_000_000_000_000
FRAME = "left_optical_frame"
POSE_COVARIANCE = np.diag([1e-5] * 3 + [1e-6] * 3)


def write_stereo_bag(
    path: Path, frames: int = 100, turns: float = 1.0, radius: float = 1.0
) -> Path:
    """Write the bag unless it is there.

    Args:
        path: of the bag.
        frames: number of pairs.
        turns: how often the camera goes round.
        radius: of its circle [m].
    """
    if (path / "metadata.yaml").exists():
        return path
    with BagWriter(path, overwrite=True) as writer:
        for index in range(frames):
            pose = pose_at(turns * index, frames, radius)
            write_pair(writer, START + index * PERIOD, pose, seed=index)
    return path


def write_pair(writer: BagWriter, stamp: int, T_map_left: np.ndarray, seed: int) -> None:
    """Write one pair with its camera infos and pose."""
    rng = np.random.default_rng(seed)
    for side, offset in (("left", 0.0), ("right", BASELINE)):
        T_map_camera = T_map_left @ make_transform(np.eye(3), [offset, 0.0, 0.0])
        pixels = render(T_map_camera, rng)
        calibration = calibration_of(offset)
        writer.write(f"/{side}/image_raw", ImageRecord(stamp, FRAME, pixels, "mono8"))
        writer.write(f"/{side}/camera_info", CameraInfoRecord(stamp, FRAME, calibration))
    writer.write("/camera_pose", PoseRecord(stamp, "map", T_map_left, POSE_COVARIANCE))


def pose_at(index: float, frames: int, radius: float = 1.0) -> np.ndarray:
    """T_map_left on a circle of `radius` [m], looking outwards and a little down."""
    angle = 2.0 * np.pi * index / frames
    pitch = 0.2
    forward = [np.cos(angle) * np.cos(pitch), np.sin(angle) * np.cos(pitch), -np.sin(pitch)]
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    rotation = np.stack([right, np.cross(forward, right), forward], axis=1)
    return make_transform(rotation, [radius * np.cos(angle), radius * np.sin(angle), 1.0])


def calibration_of(offset: float) -> CameraCalibration:
    """The camera at +x `offset` [m] of the left one; a little distortion, so that there is work."""
    camera = room.CAMERA
    projection = np.hstack([camera.matrix, [[-camera.fx * offset], [0.0], [0.0]]])
    distortion = np.array([1e-6, 0.0, 0.0, 0.0, 0.0])
    return CameraCalibration(
        camera.width, camera.height, "plumb_bob", distortion, camera.matrix, np.eye(3), projection
    )


def render(T_map_camera: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """What the camera sees, shape (480, 640), uint8, with noise of 2 gray levels."""
    points = room.cloud(T_map_camera).astype(np.float64)
    world = points @ T_map_camera[:3, :3].T + T_map_camera[:3, 3]
    brightness = np.full(world.shape[:2], 110.0)
    for octave, amplitude in ((4.0, 40.0), (16.0, 40.0), (50.0, 35.0)):
        brightness += amplitude * value_noise(world * octave)
    image = np.nan_to_num(brightness, nan=0.0) + rng.normal(0.0, 2.0, brightness.shape)
    return np.clip(cv2.GaussianBlur(image, (3, 3), 0.6), 0, 255).astype(np.uint8)


def value_noise(places: np.ndarray) -> np.ndarray:
    """Smooth random values in [-1, 1] at places, shape (..., 3)."""
    places = np.nan_to_num(places)
    base = np.floor(places).astype(np.int64)
    weight = places - base
    weight = weight * weight * (3.0 - 2.0 * weight)
    total = np.zeros(places.shape[:-1])
    for corner in np.ndindex(2, 2, 2):
        share = np.prod(np.where(corner, weight, 1.0 - weight), axis=-1)
        total += share * _hash(base + np.array(corner))
    return total


def _hash(cells: np.ndarray) -> np.ndarray:
    mixed = cells @ np.array([73856093, 19349663, 83492791])
    mixed = ((mixed ^ (mixed >> 13)) * 1274126177) & 0x7FFFFFFF
    return (mixed % 2001 - 1000) / 1000.0
