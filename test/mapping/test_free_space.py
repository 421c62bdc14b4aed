"""Free space of organized scans: the stated rule, and what it must never do."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import ndimage

from infomap_ros.geometry import PinholeCamera, make_transform
from infomap_ros.mapping import VoxelMap, VoxelMapConfig

from .naive import Verdict, measured_depths, seen_through
from .scenes import Scene, look_at, random_pose, random_scene, with_holes

SIGMA = 0.004


def assert_follows_rule(
    points: np.ndarray,
    camera: PinholeCamera,
    pose: np.ndarray,
    size: float,
    max_range: float = 3.0,
    association_sigmas: float = 0.0,
    pose_covariance: np.ndarray | None = None,
    threads: int = 1,
) -> Verdict:
    """Integrate one scan and compare the voxels that it freed with the oracle's."""
    config = VoxelMapConfig(
        voxel_size=size,
        max_range=max_range,
        association_sigmas=association_sigmas,
        default_sigma=SIGMA,
        threads=threads,
    )
    voxel_map = VoxelMap(config)
    voxel_map.integrate(points, pose, pose_covariance=pose_covariance, camera=camera)
    pose_covariance = np.zeros((6, 6)) if pose_covariance is None else pose_covariance
    depths = measured_depths(
        points,
        camera,
        pose,
        max_range,
        association_sigmas,
        np.eye(3) * SIGMA**2,
        pose_covariance,
    )
    verdict = seen_through(depths, camera, pose, size, max_range)
    log_odds = voxel_map.log_odds((verdict.indices + 0.5) * size)
    expected = verdict.free & ~(log_odds > 0.0)
    wrong = ((log_odds < 0.0) != expected) & verdict.clear
    assert not wrong.any(), f"{wrong.sum()} voxels, first {verdict.indices[wrong][0]}"
    assert verdict.clear.mean() > 0.99
    listed, values = voxel_map.voxels()
    assert (values < 0.0).sum() == (log_odds < 0.0).sum(), "voxels were freed outside the frustum"
    assert len(listed) == (log_odds != 0.0).sum()
    return verdict


@pytest.mark.parametrize("seed", range(6))
def test_voxels_are_freed_by_the_rule_in_random_scenes(seed):
    rng = np.random.default_rng(seed)
    width, height = int(rng.integers(17, 52)), int(rng.integers(17, 40))
    focal = rng.uniform(0.7, 1.5) * width
    camera = PinholeCamera(width, height, focal, focal * 1.1, width / 2 - 1.3, height / 2 + 0.7)
    pose = random_pose(rng)
    points = with_holes(random_scene(rng).points(camera, pose), rng, 0.15)
    size = float(rng.choice([0.05, 0.08, 0.11]))
    verdict = assert_follows_rule(points, camera, pose, size, max_range=1.8)
    assert verdict.free.sum() > 100


@pytest.mark.parametrize("threads", [1, 2])
def test_depths_count_less_the_deviations_of_range_and_position(rng, threads):
    camera = PinholeCamera(45, 31, 38.0, 40.0, 21.0, 14.0)
    pose = random_pose(rng)
    points = with_holes(random_scene(rng).points(camera, pose), rng, 0.1)
    factors = rng.normal(0.0, 0.01, (6, 6))
    assert_follows_rule(
        points,
        camera,
        pose,
        0.08,
        max_range=1.7,
        association_sigmas=3.0,
        pose_covariance=factors @ factors.T,
        threads=threads,
    )


def test_rule_holds_for_cubes_that_are_free_as_a_whole(rng):
    # Far walls and small voxels: most blocks are decided above the voxels.
    camera = PinholeCamera(64, 48, 80.0, 80.0, 31.5, 23.5)
    pose = random_pose(rng)
    scene = Scene(planes=[(*pose[:3, 2], float(pose[:3, 2] @ pose[:3, 3]) + 1.5)])
    verdict = assert_follows_rule(scene.points(camera, pose), camera, pose, 0.025, max_range=2.0)
    blocks = verdict.free.reshape(-1, 512).all(axis=1)
    assert blocks.sum() > 10


def test_rule_holds_for_the_block_that_the_camera_is_in(rng):
    # A voxel of 20 cm, so that the camera's block and its neighbors are most of what is seen.
    camera = PinholeCamera(33, 27, 25.0, 25.0, 16.0, 13.0)
    for _ in range(3):
        pose = random_pose(rng)
        points = with_holes(random_scene(rng).points(camera, pose), rng, 0.2)
        assert_follows_rule(points, camera, pose, 0.2)


def test_rule_holds_for_a_pose_along_the_axes():
    # Faces of voxels are parallel to the image plane, the camera sits on a voxel's corner region.
    camera = PinholeCamera(32, 24, 30.3, 30.3, 15.4, 11.6)
    pose = make_transform(np.eye(3), [0.013, -0.027, 0.031])
    depth = np.full((24, 32), 1.213)
    depth[8:12, 5:20] = 0.777
    assert_follows_rule(camera.back_project(depth), camera, pose, 0.05, max_range=1.6)


def test_one_pixel_is_an_image():
    camera = PinholeCamera(1, 1, 4.0, 4.0, 0.0, 0.0)
    pose = look_at(np.array([0.01, 0.02, 0.03]), np.array([1.0, 0.3, 0.2]))
    assert_follows_rule(camera.back_project(np.array([[1.5]])), camera, pose, 0.07)


def test_rays_beyond_the_range_free_space_up_to_it(rng):
    camera = PinholeCamera(32, 24, 30.0, 30.0, 15.5, 11.5)
    pose = random_pose(rng)
    points = camera.back_project(np.full((24, 32), 9.0))
    verdict = assert_follows_rule(points, camera, pose, 0.1, max_range=1.5)
    centers = (verdict.indices[verdict.free] + 0.5) * 0.1
    distances = np.linalg.norm(centers - pose[:3, 3], axis=1)
    assert distances.max() < 1.5
    assert distances.max() > 1.3


# What holds for every rule.


def map_of(
    scene: Scene,
    poses: list[np.ndarray],
    camera: PinholeCamera,
    config: VoxelMapConfig,
    noise: float = 0.0,
    seed: int = 0,
) -> VoxelMap:
    """Integrate what a camera with some range noise sees of a scene."""
    rng = np.random.default_rng(seed)
    voxel_map = VoxelMap(config)
    for pose in poses:
        points = scene.points(camera, pose)
        points = points * (1.0 + noise * rng.normal(size=(*points.shape[:2], 1)) / points[..., 2:])
        voxel_map.integrate(points, pose, camera=camera)
    return voxel_map


@pytest.mark.parametrize("seed", range(4))
def test_what_is_free_lies_in_front_of_the_surface(seed):
    rng = np.random.default_rng(100 + seed)
    camera = PinholeCamera(160, 120, 130.0, 130.0, 79.5, 59.5)
    scene, pose = random_scene(rng), random_pose(rng)
    config = VoxelMapConfig(voxel_size=0.04, max_range=4.0, default_sigma=0.002)
    voxel_map = map_of(scene, [pose], camera, config)
    indices, log_odds = voxel_map.voxels()
    free = indices[log_odds < 0.0]
    assert len(free) > 5000
    corners = np.array(np.meshgrid(*[[0.01, 0.5, 0.99]] * 3)).reshape(3, -1).T
    samples = (free[:, None] + corners) * 0.04
    in_camera = (samples - pose[:3, 3]) @ pose[:3, :3]
    pixels = camera.project(in_camera)
    seen = (pixels > -0.5).all(axis=-1) & (pixels < [159.5, 119.5]).all(axis=-1)
    assert seen.mean() > 0.95
    hidden = scene.first_hit(pose[:3, 3], samples - pose[:3, 3]) <= 1.0
    assert not (hidden & seen).any()


def test_space_behind_a_surface_stays_unknown(rng):
    camera = PinholeCamera(160, 120, 130.0, 130.0, 79.5, 59.5)
    scene, pose = random_scene(rng), random_pose(rng)
    config = VoxelMapConfig(voxel_size=0.04, max_range=4.0, default_sigma=0.005)
    voxel_map = map_of(scene, [pose], camera, config)
    ray = scene.points(camera, pose).reshape(-1, 3) @ pose[:3, :3].T
    # 3 sigma of association and two voxels' diagonals beyond what was measured
    for beyond in (0.16, 0.3, 0.6):
        behind = pose[:3, 3] + ray * (1.0 + beyond / np.linalg.norm(ray, axis=1, keepdims=True))
        nearest_surface = scene.first_hit(behind, -ray) * np.linalg.norm(ray, axis=1)
        deep = behind[nearest_surface > beyond - 0.01]
        assert len(deep) > 1000
        assert not voxel_map.is_known(deep).any()


def test_unmeasured_pixels_free_nothing():
    camera = PinholeCamera(64, 48, 60.0, 60.0, 31.5, 23.5)
    depth = np.full((48, 64), 2.0)
    depth[:, 32:] = np.nan
    voxel_map = VoxelMap(VoxelMapConfig(voxel_size=0.05, max_range=3.0))
    voxel_map.integrate(camera.back_project(depth), np.eye(4), camera=camera)
    indices, _ = voxel_map.voxels()
    in_camera = (indices + 0.5) * 0.05
    away = in_camera[in_camera[:, 2] > 0.6]  # there a cell is at most 4 pixels wide
    assert camera.project(away)[:, 0].max() < 36.0
    assert voxel_map.is_known([[-0.3, 0.0, 1.0]]).all()


def moving_poses(count: int, target: np.ndarray, seed: int) -> list[np.ndarray]:
    rng = np.random.default_rng(seed)
    positions = rng.uniform([-0.4, -0.6, -0.3], [0.4, 0.6, 0.3], (count, 3))
    return [look_at(p, target + rng.normal(0.0, 0.1, 3), rng.normal(0.0, 0.2)) for p in positions]


def test_a_thin_pole_before_a_far_wall_is_not_erased():
    # 1 cm in voxels of 5 cm: 2 to 4 pixels wide, among pixels that see the wall 3 m behind it.
    pole = np.array([1.913, 0.031])
    scene = Scene(planes=[(1.0, 0.0, 0.0, 5.0)], poles=[(*pole, 0.005)])
    camera = PinholeCamera(320, 240, 525.0, 525.0, 159.5, 119.5)
    poses = moving_poses(20, np.array([*pole, 0.0]), seed=3)
    config = VoxelMapConfig(voxel_size=0.05, max_range=6.0, default_sigma=0.005)
    voxel_map = map_of(scene, poses, camera, config, noise=0.003)
    heights = np.arange(-0.225, 0.23, 0.05)
    along = np.c_[np.tile(pole, (len(heights), 1)), heights]
    assert (voxel_map.log_odds(along) > 0.0).all()
    beside = along + np.array([0.0, 0.2, 0.0])
    assert (voxel_map.probability(beside) < 0.05).all()


def test_a_floor_seen_at_a_grazing_angle_is_not_erased():
    # From 25 cm above the floor, 2.9 m away, the lines of sight meet it at 5 degrees.
    scene = Scene(planes=[(0.0, 0.0, 1.0, -0.2613)])
    camera = PinholeCamera(320, 240, 400.0, 400.0, 159.5, 119.5)
    rng = np.random.default_rng(5)
    poses = [
        look_at(p, np.array([3.0, 0.0, -0.26]))
        for p in rng.uniform([-0.3, -0.3, -0.03], [0.3, 0.3, 0.03], (20, 3))
    ]
    config = VoxelMapConfig(voxel_size=0.05, max_range=4.0, default_sigma=0.005)
    voxel_map = map_of(scene, poses, camera, config, noise=0.004)
    x, y = np.meshgrid(np.arange(2.0, 3.2, 0.05) + 0.02, np.arange(-0.3, 0.3, 0.05) + 0.02)
    floor = np.stack([x, y, np.full(x.shape, -0.2613)], axis=-1).reshape(-1, 3)
    assert voxel_map.is_known(floor).all()
    assert (voxel_map.log_odds(floor) > 0.0).all()
    assert (voxel_map.probability(floor + np.array([0.0, 0.0, 0.15])) < 0.05).all()


def test_a_table_top_seen_edge_on_is_not_seen_through():
    """Its pixels, and two beside each, are not measured: a matcher's jumps of depth are dropped.

    3 cm in voxels of 5 cm, 1.2 to 1.8 m away from the nearest place, before a wall at 4 m.
    """
    camera, size = PinholeCamera(320, 240, 330.0, 330.0, 159.5, 119.5), 0.05
    low, high = np.array([-0.4, -0.015, 1.7]), np.array([0.4, 0.015, 2.3])
    voxel_map = VoxelMap(VoxelMapConfig(voxel_size=size, max_range=5.0))
    rays = camera.back_project(np.ones((240, 320)))
    for position in np.random.default_rng(7).uniform([-0.3, -0.08, 0.0], [0.3, 0.08, 0.5], (20, 3)):
        crossings = np.sort(
            np.stack([low - position, high - position])[:, None, None] / rays, axis=0
        )
        is_hit = crossings[0].max(axis=-1) < crossings[1].min(axis=-1)
        depth = np.full(is_hit.shape, 4.0 - position[2])
        depth[ndimage.binary_dilation(is_hit, np.ones((5, 5)))] = np.nan
        voxel_map.integrate(
            camera.back_project(depth), make_transform(np.eye(3), position), camera=camera
        )
    inside = np.moveaxis(np.mgrid[-8:8, 0:1, 34:46], 0, -1).reshape(-1, 3)  # of the table top
    middle = (inside + 0.5) * size * (1.0, 0.0, 1.0)
    above = middle - (0.0, 0.2, 0.0)
    assert (voxel_map.probability(middle) >= 0.5).all()
    assert (voxel_map.probability(above) < 0.05).mean() > 0.9


def test_blocks_beside_the_view_are_not_looked_at():
    camera, pose = PinholeCamera(80, 60, 50.0, 50.0, 39.5, 29.5), look_at(np.zeros(3), np.ones(3))
    points = random_scene(np.random.default_rng(3)).points(camera, pose)
    voxel_map = VoxelMap(VoxelMapConfig(voxel_size=0.02, max_range=3.0))

    report = voxel_map.integrate(points, pose, camera=camera)

    indices, values = voxel_map.voxels()
    freed = len(np.unique(indices[values < 0.0] >> 3, axis=0))
    assert freed <= report.blocks_seen_through < 3.0 * freed
