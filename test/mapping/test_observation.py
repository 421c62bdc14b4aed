"""One Gaussian per surface voxel: merging by eq. (4), and one observation per voxel and scan."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from infomap_ros.geometry import PinholeCamera, PoseUncertainty
from infomap_ros.mapping import VoxelMap, VoxelMapConfig
from infomap_ros.stereo import StereoConfig

from .naive import merged, point_covariance
from .scenes import look_at

SIZE = 0.05
ORIGIN = np.array([0.003, 0.004, 0.005])
VOXEL_CENTER = (np.array([20, 6, -4]) + 0.5) * SIZE
POSE_COVARIANCE = np.diag([1e-4, 2e-4, 3e-4, 1e-4, 2e-4, 5e-5])


def random_covariance(rng: np.random.Generator, sigma: float) -> np.ndarray:
    factor = rng.normal(0.0, sigma, (3, 3))
    return factor @ factor.T + np.eye(3) * sigma**2 / 4.0


def point_at(pose: np.ndarray, target: np.ndarray) -> np.ndarray:
    return (target - pose[:3, 3]) @ pose[:3, :3]


OWN_VOXELS = {"voxel_size": SIZE, "association_sigmas": 0.0, "error_correlation": 0.0}


def poses_around(rng: np.random.Generator, count: int) -> list[np.ndarray]:
    return [
        look_at(ORIGIN + rng.uniform(-0.3, 0.3, 3), VOXEL_CENTER, rng.uniform(-3, 3))
        for _ in range(count)
    ]


def map_with_own_voxels(**parameters: float) -> VoxelMap:
    """Points are independent, and inform the voxel that they lie in and no other."""
    return VoxelMap(VoxelMapConfig(**OWN_VOXELS | parameters))


def the_gaussian(voxel_map: VoxelMap) -> tuple[np.ndarray, np.ndarray]:
    indices, means, covariances = voxel_map.gaussians()
    assert indices.tolist() == [[20, 6, -4]]
    return means[0], covariances[0]


def test_scans_merge_by_equation_4_in_any_order(rng):
    # One point each, so that its correlation with others is of no account but for what noise chose.
    poses = poses_around(rng, 3)
    targets = VOXEL_CENTER + rng.uniform(-0.02, 0.02, (3, 3))
    noise = [random_covariance(rng, 0.005) for _ in poses]
    observed = []
    for pose, target, covariance in zip(poses, targets, noise, strict=True):
        arm = target - pose[:3, 3]
        sight = -arm / np.linalg.norm(arm)
        observed.append(
            point_covariance(pose[:3, :3], arm, covariance, POSE_COVARIANCE, sight, SIZE)
        )
    mean, covariance = merged(list(targets), observed)
    independent = PoseUncertainty(np.zeros((6, 6)), white=POSE_COVARIANCE)
    for order in itertools.permutations(range(3)):
        voxel_map = map_with_own_voxels(error_correlation=1.0)
        for i in order:
            voxel_map.integrate(
                [point_at(poses[i], targets[i])], poses[i], noise[i][None], independent
            )
        found_mean, found_covariance = the_gaussian(voxel_map)
        np.testing.assert_allclose(found_mean, mean, atol=1e-7)
        np.testing.assert_allclose(found_covariance, covariance, rtol=2e-5, atol=1e-11)
        np.testing.assert_array_equal(found_covariance, found_covariance.T)


def test_a_wall_of_a_hundred_thousand_voxels_keeps_each_point(rng):
    size = 0.01
    y, z = np.meshgrid(np.arange(-200, 200), np.arange(-125, 125), indexing="ij")
    voxels = np.stack([np.full(y.shape, 300), y, z], axis=-1).reshape(-1, 3)
    points = (voxels + rng.uniform(0.2, 0.8, voxels.shape)) * size
    order = rng.permutation(len(points))
    config = VoxelMapConfig(
        voxel_size=size, association_sigmas=0.0, default_sigma=0.001, max_range=9.0
    )
    voxel_map = VoxelMap(config)
    for part in np.array_split(order, 8):
        voxel_map.integrate(points[part], np.eye(4))
    assert voxel_map.surface_voxels > 0.97 * len(points)  # the rest was seen through at a slant
    indices, means, _ = voxel_map.gaussians()
    place = {tuple(voxel): point for voxel, point in zip(voxels.tolist(), points, strict=True)}
    expected = np.array([place[tuple(index)] for index in indices.tolist()])
    np.testing.assert_allclose(means, expected, atol=1e-6)


# One observation per voxel and scan.


def covariance_of(
    count: int, noise: np.ndarray, pose: np.ndarray, **parameters: float
) -> np.ndarray:
    """What the voxel learns from `count` points scattered about its center."""
    voxel_map = map_with_own_voxels(**parameters)
    offsets = np.random.default_rng(count).normal(0.0, 0.004, (count, 3))
    targets = VOXEL_CENTER + (offsets - offsets.mean(axis=0)).clip(-0.02, 0.02)
    covariances = np.tile(noise, (count, 1, 1))
    report = voxel_map.integrate(point_at(pose, targets), pose, covariances, POSE_COVARIANCE)
    assert (report.points_used, report.voxels_observed) == (count, 1)
    return the_gaussian(voxel_map)[1]


@pytest.mark.parametrize("correlation", [0.0, 0.3, 1.0])
@pytest.mark.parametrize("count", [1, 2, 1000])
def test_covariance_of_a_voxel_is_that_of_the_formula(rng, count, correlation):
    pose = poses_around(rng, 1)[0]
    noise = random_covariance(rng, 0.01)
    arm = VOXEL_CENTER - pose[:3, 3]
    of_mean = noise * (correlation + (1.0 - correlation) / count)
    expected = point_covariance(
        pose[:3, :3], arm, of_mean, POSE_COVARIANCE, -arm / np.linalg.norm(arm), SIZE
    )
    found = covariance_of(count, noise, pose, error_correlation=correlation)
    np.testing.assert_allclose(found, expected, rtol=1e-3, atol=1e-7)


def test_the_pose_error_does_not_shrink_with_the_number_of_points(rng):
    pose = poses_around(rng, 1)[0]
    noise = random_covariance(rng, 0.01)
    sight = VOXEL_CENTER - pose[:3, 3]
    sight /= np.linalg.norm(sight)
    of_one_point = sight @ pose[:3, :3] @ noise @ pose[:3, :3].T @ sight
    one, thousand = covariance_of(1, noise, pose), covariance_of(1000, noise, pose)
    lost = sight @ (one - thousand) @ sight
    assert lost == pytest.approx(of_one_point * 0.999, rel=1e-2)
    assert np.linalg.eigvalsh(thousand)[0] > POSE_COVARIANCE[0, 0]
    doubled = covariance_of(2000, noise, pose)
    np.testing.assert_allclose(doubled, thousand, rtol=1e-2, atol=1e-6)


def test_the_correlation_of_one_scan_replaces_that_of_the_configuration(rng):
    pose = poses_around(rng, 1)[0]
    point, noise = point_at(pose, VOXEL_CENTER), random_covariance(rng, 0.01)
    points, covariances = np.tile(point, (50, 1)), np.tile(noise, (50, 1, 1))
    configured, given = map_with_own_voxels(error_correlation=0.4), map_with_own_voxels()
    configured.integrate(points, pose, covariances)
    given.integrate(points, pose, covariances, error_correlation=0.4)
    np.testing.assert_array_equal(the_gaussian(configured)[1], the_gaussian(given)[1])


def test_a_scan_of_unknown_correlation_is_taken_for_one_of_stereo(rng):
    pose = poses_around(rng, 1)[0]
    points, noise = np.tile(point_at(pose, VOXEL_CENTER), (500, 1)), np.eye(3) * 1e-4
    voxel_map = VoxelMap(VoxelMapConfig(voxel_size=SIZE, association_sigmas=0.0))
    voxel_map.integrate(points, pose, np.tile(noise, (500, 1, 1)))
    correlation = StereoConfig().error_correlation
    expected = 1e-4 * (correlation + (1.0 - correlation) / 500)
    along_normal = np.linalg.eigvalsh(the_gaussian(voxel_map)[1])[0]
    assert along_normal == pytest.approx(expected, rel=1e-3)


def test_covariances_may_come_as_upper_triangles(rng):
    pose, noise = poses_around(rng, 1)[0], random_covariance(rng, 0.01)
    full, upper = map_with_own_voxels(), map_with_own_voxels()
    points = [point_at(pose, VOXEL_CENTER)]
    full.integrate(points, pose, noise[None])
    upper.integrate(points, pose, noise[np.triu_indices(3)][None])
    np.testing.assert_array_equal(the_gaussian(full)[1], the_gaussian(upper)[1])


def test_points_of_one_voxel_are_averaged(rng):
    pose = poses_around(rng, 1)[0]
    targets = VOXEL_CENTER + rng.uniform(-0.02, 0.02, (7, 3))
    voxel_map = map_with_own_voxels()
    voxel_map.integrate([point_at(pose, target) for target in targets], pose)
    np.testing.assert_allclose(the_gaussian(voxel_map)[0], targets.mean(axis=0), atol=1e-6)


def test_a_wall_seen_by_a_camera_has_the_covariance_of_the_formula():
    # Across the wall: noise of the mean and pose. Along it: the voxel's own extent.
    camera = PinholeCamera(120, 96, 300.0, 300.0, 59.5, 47.5)
    points = camera.back_project(np.full((96, 120), 1.025))
    sigma, pose_sigma = 0.003, 0.004
    config = VoxelMapConfig(voxel_size=SIZE, default_sigma=sigma, error_correlation=0.0)
    voxel_map = VoxelMap(config)
    pose_covariance = np.diag([0.0, 0.0, pose_sigma**2, 0.0, 0.0, 0.0])
    voxel_map.integrate(points, np.eye(4), None, pose_covariance, camera)
    indices, means, covariances = voxel_map.gaussians()
    inner = (indices[:, 2] == 20) & (np.abs(indices[:, :2] + 0.5) < 2.0).all(axis=1)
    assert inner.sum() == 16
    np.testing.assert_allclose(means[inner, 2], 1.025, atol=1e-6)
    pixels = (SIZE * 300.0 / 1.025) ** 2
    np.testing.assert_allclose(
        covariances[inner, 2, 2], pose_sigma**2 + sigma**2 / pixels, rtol=0.01
    )
    np.testing.assert_allclose(covariances[inner, 0, 0], SIZE**2 / 12.0, rtol=0.01)


def test_a_surface_is_where_occupancy_and_mean_agree():
    camera = PinholeCamera(120, 96, 300.0, 300.0, 59.5, 47.5)
    voxel_map = VoxelMap(VoxelMapConfig(voxel_size=SIZE, default_sigma=0.02))
    voxel_map.integrate(camera.back_project(np.full((96, 120), 1.025)), np.eye(4), camera=camera)
    indices, means, _ = voxel_map.gaussians()
    assert set(indices[:, 2].tolist()) == {20}, "neighbors that noise might reach are no surface"
    assert (np.abs(means - (indices + 0.5) * SIZE) <= 0.6 * SIZE + 1e-6).all()
    assert (voxel_map.log_odds((indices + 0.5) * SIZE) > 0.0).all()
    assert voxel_map.surface_voxels == len(indices)


@pytest.mark.parametrize(("size", "sigma"), [(0.5, 1e-5), (10.0, 1e-3)])
def test_points_that_are_far_better_known_than_their_voxel_is_wide_keep_their_mean(size, sigma):
    camera = PinholeCamera(120, 96, 100.0, 100.0, 59.5, 47.5)
    distance = 5.3 * size
    turn = look_at(np.zeros(3), np.array([1.0, 0.3, 0.2]))
    config = VoxelMapConfig(voxel_size=size, max_range=10.0 * size, default_sigma=sigma)
    voxel_map = VoxelMap(config)
    for _ in range(30):
        points = camera.back_project(np.full((96, 120), distance))
        voxel_map.integrate(points, turn, camera=camera)
    indices, means, covariances = voxel_map.gaussians()
    assert len(indices) > 5
    off = (means - turn[:3, 3]) @ turn[:3, 2] - distance
    sigmas = np.sqrt(turn[:3, 2] @ covariances @ turn[:3, 2])
    inner = np.abs(off) < 0.1 * size  # beside them voxels at the border of the image
    assert inner.sum() > 5
    assert np.median(np.abs(off[inner])) < 2e-3 * size
    assert (np.abs(off[inner]) < 5.0 * sigmas[inner] + 1e-4 * size).mean() > 0.9
