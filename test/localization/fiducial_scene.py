"""A room of points round a camera, and what the camera measures of them, for the filter's tests."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from infomap_ros.geometry import (
    PinholeCamera,
    invert_transform,
    make_transform,
    transform_points,
)
from infomap_ros.localization.fiducials.observations import FiducialObservations

CAMERA = PinholeCamera(640, 480, 500.0, 500.0, 319.5, 239.5)
BASELINE = 0.12
PIXEL_SIGMA = 0.3
RHO_SIGMA = 0.3 / (CAMERA.fx * BASELINE)


def room(count: int, rng: np.random.Generator) -> np.ndarray:
    """Points on a ring of radius 3 to 6 m, shape (count, 3)."""
    angle, radius = rng.uniform(0, 2 * np.pi, count), rng.uniform(3, 6, count)
    height = rng.uniform(-1.5, 1.5, count)
    return np.column_stack([radius * np.cos(angle), radius * np.sin(angle), height])


def wall(count: int, rng: np.random.Generator) -> np.ndarray:
    """Points 2 to 5 m in front of a camera at the identity, shape (count, 3)."""
    z = rng.uniform(2, 5, count)
    return np.column_stack(
        [rng.uniform(-0.5, 0.5, count) * z, rng.uniform(-0.4, 0.4, count) * z, z]
    )


def looking(position: np.ndarray, yaw: float, pitch: float = 0.0) -> np.ndarray:
    """T_map_camera of a camera that looks along a heading; map z is up, shape (4, 4)."""
    level = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
    turn = Rotation.from_euler("zy", [yaw, pitch]).as_matrix()
    return make_transform(turn @ level, position)


def observe(
    points: np.ndarray,
    T_map_camera: np.ndarray,
    rng: np.random.Generator | None,
    ids: np.ndarray | None = None,
    most: int = 60,
) -> FiducialObservations:
    """Noisy measurements of those in view (exact ones without rng)."""
    inside = transform_points(invert_transform(T_map_camera), points)
    pixels = CAMERA.project(inside)
    size = [CAMERA.width - 1, CAMERA.height - 1]
    with np.errstate(invalid="ignore"):
        seen = np.flatnonzero((inside[:, 2] > 0.3) & ((pixels >= 0) & (pixels < size)).all(axis=1))
    seen = seen[:most]
    names = np.arange(len(points)) if ids is None else ids
    noise = np.zeros((len(seen), 3)) if rng is None else rng.normal(size=(len(seen), 3))
    return FiducialObservations(
        names[seen],
        pixels[seen] + PIXEL_SIGMA * noise[:, :2],
        np.full(len(seen), PIXEL_SIGMA),
        1.0 / inside[seen, 2] + RHO_SIGMA * noise[:, 2],
        np.full(len(seen), RHO_SIGMA),
    )


def pose_error(true: np.ndarray, estimated: np.ndarray) -> np.ndarray:
    """(dt, rotation vector) by docs/conventions.md, shape (6,)."""
    turned = Rotation.from_matrix(true[:3, :3] @ estimated[:3, :3].T).as_rotvec()
    return np.concatenate([true[:3, 3] - estimated[:3, 3], turned])


def squared_distance(error: np.ndarray, covariance: np.ndarray) -> float:
    """error^T covariance^-1 error."""
    return float(error @ np.linalg.solve(covariance, error))
