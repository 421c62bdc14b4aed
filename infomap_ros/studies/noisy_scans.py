"""Scans of a known scene with errors drawn from the covariances that come with them.

Random scenes of known surfaces: planes, boxes and spheres, with exact rays and distances.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter
from scipy.spatial.transform import Rotation

from infomap_ros.geometry import (
    Box,
    PinholeCamera,
    PlacedSolid,
    PoseUncertainty,
    Sphere,
    invert_transform,
    make_transform,
    transform_points,
)
from infomap_ros.geometry.transforms import FloatArray

_NORMAL_STEP = 1e-5  # of the finite differences that give normals [m]


@dataclass(frozen=True, eq=False)
class AnalyticScene:
    """Half-spaces, boxes and spheres.

    Attributes:
        planes: rows (n, o): everything with ``n @ p < o`` is solid, n of unit length, shape (P, 4).
        solids: boxes and spheres, placed in the world.
    """

    planes: FloatArray
    solids: Sequence[PlacedSolid]

    def signed_distance(self, points: FloatArray) -> FloatArray:
        """Distance to the nearest surface, negative inside; points (N, 3) [m] -> (N,) [m]."""
        distances = points @ self.planes[:, :3].T - self.planes[:, 3]
        nearest = distances.min(axis=1, initial=np.inf)
        for placed in self.solids:
            local = transform_points(invert_transform(placed.transform), points)
            nearest = np.minimum(nearest, placed.solid.signed_distance(local))
        return np.asarray(nearest)

    def normals(self, points: FloatArray) -> FloatArray:
        """Direction in which the signed distance grows, (N, 3) [m] -> (N, 3)."""
        gradient = np.empty_like(points)
        for axis in range(3):
            step = _NORMAL_STEP * np.eye(3)[axis]
            ahead, behind = self.signed_distance(points + step), self.signed_distance(points - step)
            gradient[:, axis] = (ahead - behind) / (2.0 * _NORMAL_STEP)
        return np.asarray(gradient / np.linalg.norm(gradient, axis=1, keepdims=True))

    def cast_rays(self, origin: FloatArray, directions: FloatArray) -> FloatArray:
        """Distance along each ray to the first surface.

        Args:
            origin: outside all solids, shape (3,) [m].
            directions: unit vectors, shape (N, 3).

        Returns:
            shape (N,) [m]; infinite where a ray meets nothing.
        """
        reached = np.full(len(directions), np.inf)
        with np.errstate(divide="ignore", invalid="ignore"):
            for *normal, offset in self.planes:
                along = directions @ np.array(normal)
                distance = (offset - origin @ np.array(normal)) / along
                reached = np.where(along < 0.0, np.minimum(reached, distance), reached)
            for placed in self.solids:
                inverse = invert_transform(placed.transform)
                start = transform_points(inverse, origin)
                rays = directions @ inverse[:3, :3].T
                reached = np.minimum(reached, _meet(placed, start, rays))
        return reached

    def depth_image(self, T_world_camera: FloatArray, camera: PinholeCamera) -> FloatArray:
        """Exact depth z of every pixel, shape (height, width) [m]; NaN where nothing is met."""
        pixels = camera.back_project(np.ones((camera.height, camera.width))).astype(np.float64)
        lengths = np.linalg.norm(pixels, axis=-1)
        directions = (pixels / lengths[..., None]).reshape(-1, 3) @ T_world_camera[:3, :3].T
        distances = self.cast_rays(T_world_camera[:3, 3], directions)
        depth = distances.reshape(lengths.shape) / lengths
        return np.where(np.isfinite(depth), depth, np.nan)


def _meet(placed: PlacedSolid, start: FloatArray, rays: FloatArray) -> FloatArray:
    """Distance at which rays, in the solid's frame, enter it; infinite where they do not."""
    if isinstance(placed.solid, Sphere):
        middle = -(rays @ start)
        root = middle**2 - (start @ start - placed.solid.radius**2)
        enter = middle - np.sqrt(root)
        return np.asarray(np.where((root > 0.0) & (enter > 0.0), enter, np.inf))
    assert isinstance(placed.solid, Box)
    half = 0.5 * np.array(placed.solid.size)
    sides = np.stack([(-half - start) / rays, (half - start) / rays])
    enter, leave = sides.min(axis=0).max(axis=1), sides.max(axis=0).min(axis=1)
    return np.asarray(np.where((enter <= leave) & (enter > 0.0), enter, np.inf))


def random_scene(rng: np.random.Generator) -> AnalyticScene:
    """A tilted floor and a wall; three boxes and three spheres of 10 to 60 cm about (0, 0, 0)."""
    floor = Rotation.from_rotvec(rng.normal(0.0, 0.1, size=3)).apply([0.0, 0.0, 1.0])
    azimuth = rng.uniform(-np.pi, np.pi)
    wall = Rotation.from_rotvec(rng.normal(0.0, 0.1, size=3)).apply(
        [np.cos(azimuth), np.sin(azimuth), 0.0]
    )
    planes = np.array([[*floor, -0.3], [*wall, -rng.uniform(0.7, 1.2)]])
    solids = []
    for i in range(6):
        place = make_transform(
            Rotation.random(random_state=rng).as_matrix(), rng.uniform(-0.5, 0.5, size=3)
        )
        if i < 3:
            x, y, z = rng.uniform(0.1, 0.6, size=3)
            solids.append(PlacedSolid(Box((x, y, z)), place, f"box {i}"))
        else:
            solids.append(PlacedSolid(Sphere(rng.uniform(0.1, 0.3)), place, f"sphere {i}"))
    return AnalyticScene(planes, solids)


def random_view(scene: AnalyticScene, rng: np.random.Generator, nearest: float = 0.3) -> FloatArray:
    """Pose T_world_camera (optical) in free space, 1 to 2 m from the middle and looking at it.

    Args:
        scene: what is looked at.
        rng: random numbers.
        nearest: smallest distance of the camera from any surface [m].
    """
    while True:
        position = rng.normal(size=3)
        position *= rng.uniform(1.0, 2.0) / np.linalg.norm(position)
        if scene.signed_distance(position[None])[0] > nearest:
            break
    forward = rng.uniform(-0.2, 0.2, size=3) - position
    forward /= np.linalg.norm(forward)
    right = np.cross(forward, rng.normal(size=3))
    right /= np.linalg.norm(right)
    return make_transform(np.stack([right, np.cross(forward, right), forward], axis=1), position)


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
