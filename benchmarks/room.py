"""The scene of the mapping benchmarks: a 10 x 10 x 3 m room with boxes and a rough floor.

Depth images are ray cast analytically, so that every benchmark and peer sees the same clouds.
"""

from __future__ import annotations

import numpy as np

from infomap_ros.geometry import PinholeCamera, make_transform

CAMERA = PinholeCamera(640, 480, 525.0, 525.0, 319.5, 239.5)


def boxes(seed: int = 1) -> np.ndarray:
    """Boxes (low, high) on the floor, shape (n, 2, 3) [m]."""
    rng = np.random.default_rng(seed)
    centers = rng.uniform(-4.5, 4.5, (14, 2))
    centers = centers[np.linalg.norm(centers, axis=1) > 1.5]
    sizes = rng.uniform(0.2, 1.2, (len(centers), 3))
    low = np.c_[centers - sizes[:, :2] / 2, np.full(len(centers), -0.2)]
    high = np.c_[centers + sizes[:, :2] / 2, sizes[:, 2]]
    return np.stack([low, high], axis=1)


def floor_height(xy: np.ndarray) -> np.ndarray:
    """Height of the rough floor [m] at (..., 2)."""
    x, y = xy[..., 0], xy[..., 1]
    return 0.03 * np.sin(3.1 * x) * np.cos(2.3 * y) + 0.02 * np.sin(7.7 * x + 5.1 * y)


def poses(count: int, seed: int = 2) -> list[np.ndarray]:
    """Camera poses T_map_camera near the middle of the room, looking around, a little down."""
    rng = np.random.default_rng(seed)
    result = []
    for i in range(count):
        yaw = 2.0 * np.pi * i / count + rng.normal(0.0, 0.1)
        pitch = rng.uniform(0.0, 0.35)
        forward = np.array(
            [np.cos(yaw) * np.cos(pitch), np.sin(yaw) * np.cos(pitch), -np.sin(pitch)]
        )
        right = np.cross(forward, [0.0, 0.0, 1.0])
        right /= np.linalg.norm(right)
        rotation = np.stack([right, np.cross(forward, right), forward], axis=1)
        position = np.r_[rng.uniform(-1.0, 1.0, 2), rng.uniform(0.8, 1.6)]
        result.append(make_transform(rotation, position))
    return result


def cloud(T_map_camera: np.ndarray, camera: PinholeCamera = CAMERA) -> np.ndarray:
    """Organized points, shape (H, W, 3), float32, camera frame [m]."""
    rays = camera.back_project(np.ones((camera.height, camera.width))).reshape(-1, 3)
    directions = rays.astype(np.float64) @ T_map_camera[:3, :3].T
    origin = T_map_camera[:3, 3]
    with np.errstate(divide="ignore", invalid="ignore"):
        inverse = 1.0 / directions
        walls = np.array([[-5.0, -5.0, -1.0], [5.0, 5.0, 3.0]])
        depth = np.max(np.stack([(w - origin) * inverse for w in walls]), axis=0).min(axis=1)
        for low, high in boxes():
            a, b = (low - origin) * inverse, (high - origin) * inverse
            enter, leave = np.minimum(a, b).max(axis=1), np.maximum(a, b).min(axis=1)
            depth = np.where((enter > 0) & (enter < leave), np.minimum(depth, enter), depth)
        floor = np.where(directions[:, 2] < 0, -origin[2] * inverse[:, 2], np.inf)
        for _ in range(6):
            at = origin[:2] + floor[:, None] * directions[:, :2]
            height = floor_height(np.where(np.isfinite(at), at, 0.0))
            floor = np.where(directions[:, 2] < 0, (height - origin[2]) * inverse[:, 2], np.inf)
        depth = np.minimum(depth, floor)
    return camera.back_project(depth.reshape(camera.height, camera.width))


def covariances(points: np.ndarray, baseline: float = 0.1, sigma: float = 0.2) -> np.ndarray:
    """Stereo-like covariances (H, W, 3, 3), float32 [m^2], disparity noise `sigma` px."""
    z = points[..., 2].astype(np.float64)
    along = sigma * z**2 / (CAMERA.fx * baseline)
    ray = points / points[..., 2:3]
    outer = ray[..., :, None] * ray[..., None, :] * (along**2)[..., None, None]
    lateral = (0.3 * z / CAMERA.fx) ** 2
    return (outer + lateral[..., None, None] * np.eye(3)).astype(np.float32)
