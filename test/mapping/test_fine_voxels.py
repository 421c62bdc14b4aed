"""Voxels of 1 mm, the resolution of the paper: memory and time stay bounded."""

from __future__ import annotations

import numpy as np
import pytest

from infomap_ros.geometry import PinholeCamera
from infomap_ros.mapping import VoxelMap, VoxelMapConfig

from .scenes import Scene, look_at

SIZE = 0.001
CAMERA = PinholeCamera(320, 240, 320.0, 320.0, 159.5, 119.5)
CONFIG = VoxelMapConfig(voxel_size=SIZE, max_range=1.2, default_sigma=0.0005, memory_limit=1.0)


def rough_ball(camera: PinholeCamera, pose: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """A ball of half a meter, seen with half a millimeter of noise; nothing around it."""
    points = Scene(spheres=[(0.0, 0.0, 0.0, 0.25)]).points(camera, pose)
    return points * rng.normal(1.0, 0.0005, (*points.shape[:2], 1)).astype(np.float32)


@pytest.fixture(scope="module")
def ball() -> VoxelMap:
    """Half a meter of ball from twelve sides."""
    rng, voxel_map = np.random.default_rng(7), VoxelMap(CONFIG)
    for azimuth in np.arange(0.0, 2.0 * np.pi, np.pi / 6.0):
        position = 0.6 * np.array([np.cos(azimuth), np.sin(azimuth), 0.3 * np.cos(3.0 * azimuth)])
        pose = look_at(position, np.zeros(3))
        voxel_map.integrate(rough_ball(CAMERA, pose, rng), pose, camera=CAMERA)
    return voxel_map


def test_a_ball_of_half_a_meter_is_mapped_at_1_mm(ball):
    indices, means, covariances = ball.gaussians()
    assert len(indices) > 200_000
    radii = np.linalg.norm(means, axis=1)
    assert np.sqrt(np.mean((radii - 0.25) ** 2)) < 0.001
    sigmas = np.sqrt(np.linalg.eigvalsh(covariances[::50])[:, 0])
    assert sigmas.max() < 0.001


def test_memory_at_1_mm_goes_with_what_was_seen(ball):
    # A dense byte grid of the box around it would hold one byte per voxel of the box.
    low, high = ball.bounds()
    box = np.prod((high - low + 1).astype(float))
    assert ball.memory_bytes() < min(0.5 * box, 300e6)
    assert ball.memory_bytes() < 2.0 * ball.known_voxels + 60.0 * len(ball.gaussians()[0]) * 3.0


def test_memory_does_not_depend_on_the_distance_between_two_patches():
    sizes = []
    for distance in (0.504, 900.0):  # whole blocks of eight voxels
        rng, voxel_map = np.random.default_rng(8), VoxelMap(CONFIG)
        small = PinholeCamera(80, 60, 320.0, 320.0, 39.5, 29.5)
        for x in (0.0, distance):
            pose = look_at(np.array([0.45, 0.0, 0.0]), np.zeros(3))
            points = rough_ball(small, pose, rng)
            pose[0, 3] += x
            voxel_map.integrate(points, pose, camera=small)
        sizes.append(voxel_map.memory_bytes())
    assert sizes[1] == pytest.approx(sizes[0], rel=0.05)
    assert sizes[1] < 50e6


@pytest.mark.parametrize("size", [0.001, 0.002, 0.003])
@pytest.mark.parametrize("scans", [1, 10])
def test_voxels_finer_than_the_noise_claim_no_more_than_is_true(size, scans):
    """A point with a sigma of 5 mm informs voxels up to three away, 3 mm of them: the mean of what
    a voxel gets stays near it, wherever the surface is."""
    rng, sigma = np.random.default_rng(3), 0.005
    camera = PinholeCamera(60, 45, 200.0, 200.0, 29.5, 22.5)
    normal = np.array([0.2, 0.1, -1.0]) / np.linalg.norm([0.2, 0.1, -1.0])
    rays = camera.back_project(np.ones((45, 60))).astype(np.float64)
    plane = rays * (0.503 * normal[2] / (rays @ normal))[..., None]
    config = VoxelMapConfig(voxel_size=size, default_sigma=sigma, error_correlation=0.0)
    voxel_map = VoxelMap(config)
    for _ in range(scans):
        points = plane + rng.normal(0.0, sigma, plane.shape)
        voxel_map.integrate(points, np.eye(4), camera=camera)
    _, means, covariances = voxel_map.gaussians()
    assert len(means) > 500
    errors = (means @ normal - 0.503 * normal[2]) / np.sqrt(normal @ covariances @ normal)
    assert 0.4 < np.mean(errors**2) < 1.1
    assert np.mean(np.abs(errors) < 2.0) > 0.93
