"""Scans of a known scene with errors drawn from the covariances that come with them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter
from scipy.spatial.transform import Rotation

from infomap_ros.geometry import PinholeCamera, PoseUncertainty, make_transform
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.studies.analytic_scene import AnalyticScene, random_view

CAMERA = PinholeCamera(width=240, height=180, fx=200.0, fy=200.0, cx=119.5, cy=89.5)
"""The camera of the simulated scans."""

_MAX_DEPTH = 4.0  # farther surfaces are not measured [m]


_SMOOTHNESS = 4.0  # of the error that neighboring pixels share [pixels]


@dataclass(frozen=True, eq=False)
class NoisyScan:
    """What `VoxelMap.integrate` takes, each with an error drawn from its covariance.

    Attributes:
        points: organized, shape (H, W, 3), camera frame [m]; NaN where nothing was measured.
        covariances: shape (H, W, 3, 3) [m^2].
        pose: T_map_camera as estimated, shape (4, 4).
        pose_covariance: of that, shape (6, 6), convention of `geometry.transforms`, or in parts.
    """

    points: NDArray[np.float32]
    covariances: NDArray[np.float32]
    pose: FloatArray
    pose_covariance: FloatArray | PoseUncertainty


@dataclass(frozen=True)
class RangeNoise:
    """Errors of a stereo pair.

    Attributes:
        along: standard deviation along the ray at a depth of 1 m, grows with its square [m].
        across: likewise across it, grows with the depth [m].
        correlation: of the errors along the ray of neighboring pixels, in [0, 1].
    """

    along: float
    across: float
    correlation: float = 0.0

    @classmethod
    def random(cls, rng: np.random.Generator, correlation: float = 0.0) -> RangeNoise:
        """2 to 10 mm along the ray and 0.5 to 2 mm across it at 1 m."""
        return cls(rng.uniform(0.002, 0.010), rng.uniform(0.0005, 0.002), correlation)

    def measure(
        self, depth: FloatArray, camera: PinholeCamera, rng: np.random.Generator
    ) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Points (H, W, 3) [m] with errors, and their covariances (H, W, 3, 3) [m^2].

        Args:
            depth: exact, shape (H, W) [m].
            camera: that looks.
            rng: random numbers.
        """
        points = camera.back_project(depth).astype(np.float64)
        rays = points / depth[..., None]
        along, across = (self.along * depth**2)[..., None], (self.across * depth)[..., None]
        covariances = (along**2)[..., None] * rays[..., :, None] * rays[..., None, :]
        covariances += (across**2)[..., None] * np.eye(3)
        errors = along * rays * self._unit_errors(depth.shape, rng)[..., None]
        errors += across * rng.normal(size=points.shape)
        return (points + errors).astype(np.float32), covariances.astype(np.float32)

    def _unit_errors(self, shape: tuple[int, ...], rng: np.random.Generator) -> FloatArray:
        """Errors of variance 1, of which neighbors share their `correlation`."""
        own = rng.normal(size=shape)
        if self.correlation == 0.0:
            return own
        shared = gaussian_filter(rng.normal(size=shape), _SMOOTHNESS, mode="wrap")
        shared *= 2.0 * np.sqrt(np.pi) * _SMOOTHNESS  # smoothing has divided the variance by that^2
        return np.sqrt(self.correlation) * shared + np.sqrt(1.0 - self.correlation) * own


def depth_of(scene: AnalyticScene, T_map_camera: FloatArray, camera: PinholeCamera) -> FloatArray:
    """Exact depth of what a camera measures, shape (H, W) [m], NaN elsewhere."""
    depth = scene.depth_image(T_map_camera, camera)
    depth[depth > _MAX_DEPTH] = np.nan
    return depth


def simulate_scans(
    scene: AnalyticScene, views: int, rng: np.random.Generator, correlation: float = 0.0
) -> list[NoisyScan]:
    """Take scans of a scene from random views.

    The pose errors (1 to 10 mm, 0.5 to 5 mrad, correlated) are
    independent from scan to scan.

    Args:
        scene: what is seen.
        views: number of scans.
        rng: random numbers.
        correlation: of the range errors of neighboring pixels, in [0, 1].
    """
    noise = RangeNoise.random(rng, correlation)
    return [_scan(scene, noise, rng) for _ in range(views)]


def _scan(scene: AnalyticScene, noise: RangeNoise, rng: np.random.Generator) -> NoisyScan:
    T_map_camera = random_view(scene, rng)
    points, covariances = noise.measure(depth_of(scene, T_map_camera, CAMERA), CAMERA, rng)
    covariance = random_pose_covariance(rng)
    estimate = misplaced(T_map_camera, rng.multivariate_normal(np.zeros(6), covariance))
    independent = PoseUncertainty(np.zeros((6, 6)), white=covariance)
    return NoisyScan(points, covariances, estimate, independent)


def random_pose_covariance(rng: np.random.Generator) -> FloatArray:
    """Of errors of 1 to 10 mm and 0.5 to 5 mrad along each axis, correlated, shape (6, 6)."""
    sigmas = np.repeat([rng.uniform(0.001, 0.010), rng.uniform(0.0005, 0.005)], 3)
    factor = rng.normal(size=(6, 6))
    factor *= sigmas[:, None] / np.linalg.norm(factor, axis=1, keepdims=True)
    return np.asarray(factor @ factor.T)


def misplaced(truth: FloatArray, error: FloatArray) -> FloatArray:
    """The estimate whose error, applied to it by `perturb_transform`, gives the truth."""
    rotation = Rotation.from_rotvec(-error[3:]).as_matrix() @ truth[:3, :3]
    return make_transform(rotation, truth[:3, 3] - error[:3])
