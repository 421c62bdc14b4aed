"""Rays meet the surface that was scanned, against exact scenes."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from infomap_ros.errors import InvalidInputError
from infomap_ros.geometry import PinholeCamera, make_transform
from infomap_ros.mapping import VoxelMap, VoxelMapConfig
from infomap_ros.studies.noisy_scans import (
    CAMERA,
    AnalyticScene,
    RangeNoise,
    depth_of,
    random_scene,
    random_view,
)

from .scenes import Scene, look_at

VIEWS = 25
SIZE = 0.04


@cache
def scanned(seed: int, along: float) -> tuple[AnalyticScene, VoxelMap, np.ndarray]:
    """A scene, its map from exactly known poses with noise of the range, and another pose."""
    rng = np.random.default_rng(seed)
    scene, noise = random_scene(rng), RangeNoise(along, 0.2 * along)
    voxel_map = VoxelMap(VoxelMapConfig(voxel_size=SIZE, max_range=4.0))
    for _ in range(VIEWS):
        pose = random_view(scene, rng)
        points, covariances = noise.measure(depth_of(scene, pose, CAMERA), CAMERA, rng)
        voxel_map.integrate(points, pose, covariances, camera=CAMERA, error_correlation=0.0)
    return scene, voxel_map, random_view(scene, rng)


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("along", [0.001, 0.004])
def test_depth_is_that_of_the_scene(seed, along):
    scene, voxel_map, pose = scanned(seed, along)
    exact = depth_of(scene, pose, CAMERA)
    found = voxel_map.render_depth(CAMERA, pose)
    both = np.isfinite(exact) & np.isfinite(found.depth)
    errors = (found.depth - exact)[both]
    assert both.mean() > 0.5
    assert abs(np.median(errors)) < 0.03 * SIZE
    assert np.median(np.abs(errors)) < 0.1 * SIZE
    assert np.quantile(np.abs(errors), 0.8) < SIZE  # else beside the edges of objects


def test_faces_of_voxels_come_before_the_surface():
    scene, voxel_map, pose = scanned(0, 0.001)
    exact = scene.depth_image(pose, CAMERA)
    rays = CAMERA.back_project(np.ones(exact.shape)).reshape(-1, 3) @ pose[:3, :3].T
    lengths = np.linalg.norm(rays, axis=1)
    faces, hits = voxel_map.first_occupied(pose[:3, 3], rays, 4.0)
    surface, met = voxel_map.cast_rays(pose[:3, 3], rays, 4.0)
    both = hits & met & np.isfinite(exact.ravel())
    assert np.median((faces / lengths - exact.ravel())[both]) < -0.25 * SIZE
    assert abs(np.median((surface / lengths - exact.ravel())[both])) < 0.05 * SIZE


def test_sigma_is_that_of_the_error():
    """One wall, no edges: errors are those of the Gaussians, wider along slanted rays."""
    rng, normal = np.random.default_rng(3), np.array([0.6, 0.0, 0.8])
    scene = AnalyticScene(np.array([[*-normal, -1.513]]), [])
    voxel_map = VoxelMap(VoxelMapConfig(voxel_size=SIZE, max_range=4.0))
    noise = RangeNoise(0.004, 0.0005)
    for _ in range(6):
        pose = make_transform(np.eye(3), rng.uniform(-0.2, 0.2, 3))
        points, covariances = noise.measure(depth_of(scene, pose, CAMERA), CAMERA, rng)
        voxel_map.integrate(points, pose, covariances, camera=CAMERA, error_correlation=0.0)
    pose = make_transform(np.eye(3), np.array([0.05, 0.02, 0.03]))
    middle = np.s_[60:120, 80:160]
    found, exact = voxel_map.render_depth(CAMERA, pose), scene.depth_image(pose, CAMERA)[middle]
    ratios = (found.depth[middle] - exact) / found.sigma[middle]
    met = np.isfinite(ratios)
    assert met.mean() > 0.99
    assert 0.3 < np.sqrt(np.mean(ratios[met] ** 2)) < 2.0


def test_a_ray_beside_a_wall_passes():
    """Parallel to a wall, a third of a voxel before the faces of its voxels and nearer."""
    camera = PinholeCamera(160, 120, 120.0, 120.0, 79.5, 59.5)
    scene = Scene(planes=[(0.0, 1.0, 0.0, 1.0)])
    voxel_map = VoxelMap(VoxelMapConfig(voxel_size=0.1, max_range=5.0, default_sigma=0.005))
    for x in np.linspace(-1.0, 1.0, 9):
        pose = look_at(np.array([x, -1.0, 0.03 * x]), np.array([x, 1.0, 0.0]))
        voxel_map.integrate(scene.points(camera, pose), pose, camera=camera)
    indices, means, _ = voxel_map.gaussians()
    wall = float(np.median(means[:, 1]))
    front = 0.1 * int(np.min(indices[:, 1]))
    origins = np.array([[-0.8, y, 0.05] for y in np.linspace(front + 0.001, wall - 0.02, 5)])
    along = np.tile([1.0, 0.0, 0.0], (len(origins), 1))
    _, hits = voxel_map.first_occupied(origins, along, 1.5)
    distances, met = voxel_map.cast_rays(origins, along, 1.5)
    assert hits.all()
    assert not met.any()
    assert (distances == 1.5).all()
    across, _ = voxel_map.cast_rays(origins, np.tile([0.0, 1.0, 0.0], (len(origins), 1)), 1.5)
    np.testing.assert_allclose(across, wall - origins[:, 1], atol=5e-3)


def test_an_object_is_no_larger_than_it_was_seen():
    """Rays beside a pole meet what is behind it."""
    camera = PinholeCamera(320, 240, 300.0, 300.0, 159.5, 119.5)
    scene = Scene(planes=[(0.0, 0.0, 1.0, 2.0)], spheres=[(0.013, 0.007, 1.0, 0.11)])
    voxel_map = VoxelMap(VoxelMapConfig(voxel_size=0.05, max_range=4.0, default_sigma=0.002))
    rng = np.random.default_rng(4)
    for _ in range(8):
        pose = make_transform(np.eye(3), rng.uniform(-0.1, 0.1, 3))
        voxel_map.integrate(scene.points(camera, pose), pose, camera=camera)
    pose = np.eye(4)
    exact = scene.points(camera, pose)[..., 2]
    found = voxel_map.render_depth(camera, pose).depth
    is_near, seen = exact < 1.5, np.isfinite(exact)
    shown = found < 1.5
    assert shown[is_near].mean() > 0.95
    assert shown[seen & ~is_near].sum() < 0.25 * is_near.sum()  # boxes: half of it and more
    boxes, _ = voxel_map.first_occupied(
        np.zeros(3), camera.back_project(np.ones(exact.shape)).reshape(-1, 3), 4.0
    )
    fat = (boxes < 1.5).reshape(exact.shape)
    assert fat[seen & ~is_near].sum() > 2 * shown[seen & ~is_near].sum()


def test_the_pose_must_be_one_and_the_range_positive():
    with pytest.raises(InvalidInputError):
        VoxelMap().render_depth(CAMERA, np.ones((4, 4)))
    with pytest.raises(InvalidInputError):
        VoxelMap().render_depth(CAMERA, np.eye(4), -1.0)


def test_an_empty_map_shows_nothing():
    image = VoxelMap().render_depth(CAMERA, np.eye(4))
    assert image.depth.shape == image.sigma.shape == (CAMERA.height, CAMERA.width)
    assert np.isnan(image.depth).all()
    assert np.isnan(image.sigma).all()
