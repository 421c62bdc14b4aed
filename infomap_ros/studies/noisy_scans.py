"""Scans of a known scene with errors drawn from the covariances that come with them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from infomap_ros.geometry import PinholeCamera, make_transform
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.studies.analytic_scene import AnalyticScene, random_view

CAMERA = PinholeCamera(width=240, height=180, fx=200.0, fy=200.0, cx=119.5, cy=89.5)
"""The camera of the simulated scans."""

_MAX_DEPTH = 4.0  # farther surfaces are not measured [m]


@dataclass(frozen=True, eq=False)
class NoisyScan:
    """What `VoxelMap.integrate` takes, each with an error drawn from its covariance.

    Attributes:
        points: organised, shape (H, W, 3), camera frame [m]; NaN where nothing was measured.
        covariances: shape (H, W, 3, 3) [m^2].
        pose: T_map_camera as estimated, shape (4, 4).
        pose_covariance: shape (6, 6), convention of `geometry.transforms`.
    """

    points: NDArray[np.float32]
    covariances: NDArray[np.float32]
    pose: FloatArray
    pose_covariance: FloatArray


def simulate_scans(scene: AnalyticScene, views: int, rng: np.random.Generator) -> list[NoisyScan]:
    """Take scans of a scene from random views.

    The errors of a scan are those of a stereo pair: along the ray they grow with the square of
    the depth (2 to 10 mm at 1 m), across it with the depth (0.5 to 2 mm at 1 m); no two pixels
    share any. The pose errors (1 to 10 mm, 0.5 to 5 mrad, correlated) are independent from scan to
    scan.

    Args:
        scene: what is seen.
        views: number of scans.
        rng: random numbers.
    """
    along, across = rng.uniform(0.002, 0.010), rng.uniform(0.0005, 0.002)
    return [_scan(scene, along, across, rng) for _ in range(views)]


def _scan(scene: AnalyticScene, along: float, across: float, rng: np.random.Generator) -> NoisyScan:
    T_map_camera = random_view(scene, rng)
    depth = scene.depth_image(T_map_camera, CAMERA)
    depth[depth > _MAX_DEPTH] = np.nan
    points = CAMERA.back_project(depth).astype(np.float64)
    rays = points / depth[..., None]
    range_sigma, side_sigma = (along * depth**2)[..., None], (across * depth)[..., None]
    covariances = (range_sigma**2)[..., None] * rays[..., :, None] * rays[..., None, :]
    covariances += (side_sigma**2)[..., None] * np.eye(3)
    errors = range_sigma * rays * rng.normal(size=(*depth.shape, 1))
    errors += side_sigma * rng.normal(size=points.shape)
    pose_covariance = _random_pose_covariance(rng)
    estimate = _misplaced(T_map_camera, rng.multivariate_normal(np.zeros(6), pose_covariance))
    return NoisyScan(
        (points + errors).astype(np.float32),
        covariances.astype(np.float32),
        estimate,
        pose_covariance,
    )


def _random_pose_covariance(rng: np.random.Generator) -> FloatArray:
    sigmas = np.repeat([rng.uniform(0.001, 0.010), rng.uniform(0.0005, 0.005)], 3)
    factor = rng.normal(size=(6, 6))
    factor *= sigmas[:, None] / np.linalg.norm(factor, axis=1, keepdims=True)
    return np.asarray(factor @ factor.T)


def _misplaced(truth: FloatArray, error: FloatArray) -> FloatArray:
    """The estimate whose error, applied to it by `perturb_transform`, gives the truth."""
    rotation = Rotation.from_rotvec(-error[3:]).as_matrix() @ truth[:3, :3]
    return make_transform(rotation, truth[:3, 3] - error[:3])
