"""Clouds without a camera: exact traversal of their rays; and rays cast through the map."""

from __future__ import annotations

import numpy as np
import pytest

from infomap_ros.errors import InvalidInputError
from infomap_ros.geometry import make_transform
from infomap_ros.mapping import VoxelMap, VoxelMapConfig

from .naive import crossed_before, ray_distance
from .scenes import Scene, random_pose

SIZE = 0.05
HALF_DIAGONAL = np.sqrt(0.75) * SIZE


def without_surfaces(points: np.ndarray) -> np.ndarray:
    """Points of which no two are so near each other that they could make a surface."""
    return points[np.unique(np.floor(points / (4.0 * SIZE)), axis=0, return_index=True)[1]]


def sparse_cloud(rng: np.random.Generator, count: int, reach: float) -> np.ndarray:
    """Points in all directions, float32 as the map takes them."""
    directions = rng.normal(size=(count, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    return (directions * rng.uniform(0.02, reach, (count, 1))).astype(np.float32)


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("sigmas", [0.0, 2.0])
def test_rays_free_exactly_the_voxels_that_they_leave_before_their_margin(seed, sigmas):
    rng = np.random.default_rng(seed)
    pose = random_pose(rng)
    points = without_surfaces(sparse_cloud(rng, 80, 2.0))
    sigma = 0.01
    config = VoxelMapConfig(
        voxel_size=SIZE,
        max_range=2.5,
        association_sigmas=sigmas,
        association_limit=0.0,  # every point informs its own voxel only
        default_sigma=sigma,
    )
    voxel_map = VoxelMap(config)
    report = voxel_map.integrate(points, pose)
    assert report.points_used == len(points)
    ends = points.astype(float) @ pose[:3, :3].T + pose[:3, 3]
    hits = {tuple(voxel) for voxel in np.floor(ends / SIZE).astype(int).tolist()}
    expected = set()
    margin = HALF_DIAGONAL + sigmas * np.sqrt(3.0) * sigma
    for end in ends:
        expected |= crossed_before(pose[:3, 3], end, SIZE, margin)
    indices, log_odds = voxel_map.voxels()
    assert {tuple(voxel) for voxel in indices[log_odds < 0.0].tolist()} == expected - hits
    assert {tuple(voxel) for voxel in indices[log_odds > 0.0].tolist()} <= hits
    assert len(expected) > 500


def test_the_margin_grows_with_the_slant_at_which_a_surface_is_met():
    # A plane that the rays meet at 20 degrees: they end where they are half a diagonal above it.
    slope = np.radians(20.0)
    rng = np.random.default_rng(2)
    across, along = rng.uniform(-0.1, 0.1, 400), rng.uniform(-0.25, 0.25, 400)
    points = np.c_[2.0 + along * np.cos(slope), across, along * np.sin(slope)]
    config = VoxelMapConfig(
        voxel_size=SIZE, max_range=4.0, association_sigmas=0.0, default_sigma=0.001
    )
    voxel_map = VoxelMap(config)
    voxel_map.integrate(points, np.eye(4))
    indices, log_odds = voxel_map.voxels()
    free = (indices[log_odds < 0.0] + 0.5) * SIZE
    normal = np.array([-np.sin(slope), 0.0, np.cos(slope)])
    heights = (free - [2.0, 0.0, 0.0]) @ normal
    corner = 0.5 * SIZE * np.abs(normal).sum()  # how far a voxel reaches towards the plane
    assert (heights > HALF_DIAGONAL - corner - 0.005).all()
    assert heights.min() < HALF_DIAGONAL + corner


def test_rays_beyond_the_range_free_space_up_to_it(rng):
    pose = random_pose(rng)
    points = sparse_cloud(rng, 40, 1.0)
    points *= 7.0 / np.linalg.norm(points, axis=1, keepdims=True)
    voxel_map = VoxelMap(VoxelMapConfig(voxel_size=SIZE, max_range=1.5))
    report = voxel_map.integrate(points, pose)
    assert (report.points_used, report.points_out_of_range) == (0, 40)
    # A ray without a surface ends in the middle of the voxel in which it reaches its range.
    ends = points.astype(float) * 1.5 / 7.0 @ pose[:3, :3].T + pose[:3, 3]
    expected = set()
    for end in (np.floor(ends / SIZE) + 0.5) * SIZE:
        expected |= crossed_before(pose[:3, 3], end, SIZE, 0.0)
    indices, log_odds = voxel_map.voxels()
    assert {tuple(voxel) for voxel in indices.tolist()} == expected
    assert (log_odds < 0.0).all()


def test_nothing_is_known_behind_a_wall():
    directions = np.random.default_rng(1).normal(size=(20000, 3))
    directions = directions[directions[:, 0] > 0.3]
    points = directions / directions[:, :1] * 2.03
    voxel_map = VoxelMap(VoxelMapConfig(voxel_size=SIZE, max_range=8.0, default_sigma=0.005))
    voxel_map.integrate(points, np.eye(4))
    indices, log_odds = voxel_map.voxels()
    assert indices[:, 0].max() <= 41  # 3 sigma beyond the surface
    assert indices[log_odds < 0.0, 0].max() <= 40


def cloud_from(scene: Scene, position: np.ndarray, directions: np.ndarray) -> np.ndarray:
    return directions * scene.first_hit(position, directions)[:, None]


def test_a_thin_pole_in_a_scan_is_not_erased():
    pole = np.array([1.513, 0.031])
    scene = Scene(planes=[(1.0, 0.0, 0.0, 5.0)], poles=[(*pole, 0.005)])
    rng = np.random.default_rng(4)
    azimuth, elevation = np.meshgrid(np.arange(-0.3, 0.3, 0.002), np.arange(-0.1, 0.1, 0.01))
    directions = np.stack([np.ones_like(azimuth), np.tan(azimuth), np.tan(elevation)], axis=-1)
    config = VoxelMapConfig(voxel_size=SIZE, max_range=6.0, default_sigma=0.005)
    voxel_map = VoxelMap(config)
    for _ in range(20):
        position = rng.uniform(-0.3, 0.3, 3) * [1.0, 1.0, 0.1]
        points = cloud_from(scene, position, directions.reshape(-1, 3))
        points += rng.normal(0.0, 0.003, points.shape)
        voxel_map.integrate(points, make_transform(np.eye(3), position))
    heights = np.arange(-0.075, 0.08, 0.05)
    along = np.c_[np.tile(pole, (len(heights), 1)), heights]
    assert (voxel_map.log_odds(along) > 0.0).all()


def test_a_floor_that_a_scan_grazes_is_not_erased():
    # From 25 cm above the floor, 1.5 to 3 m away: 9 to 5 degrees; rings as a spinning lidar draws.
    scene = Scene(planes=[(0.0, 0.0, 1.0, -0.2613)])
    rng = np.random.default_rng(6)
    angles = np.arcsin(0.26 / np.arange(1.4, 3.2, 0.04))
    azimuth, elevation = np.meshgrid(np.arange(-0.3, 0.3, 0.005), -angles)
    directions = np.stack([np.ones_like(azimuth), np.tan(azimuth), np.tan(elevation)], axis=-1)
    config = VoxelMapConfig(voxel_size=SIZE, max_range=4.0, default_sigma=0.005)
    voxel_map = VoxelMap(config)
    for _ in range(20):
        position = rng.uniform(-0.3, 0.3, 3) * [1.0, 1.0, 0.1]
        points = cloud_from(scene, position, directions.reshape(-1, 3))
        points += rng.normal(0.0, 0.003, points.shape)
        voxel_map.integrate(points, make_transform(np.eye(3), position))
    x, y = np.meshgrid(np.arange(1.8, 2.6, 0.05) + 0.02, np.arange(-0.3, 0.3, 0.05) + 0.02)
    floor = np.stack([x, y, np.full(x.shape, -0.2613)], axis=-1).reshape(-1, 3)
    assert (voxel_map.log_odds(floor) > 0.0).all()


def test_points_at_the_sensor_are_no_reason_to_free_anything():
    voxel_map = VoxelMap(VoxelMapConfig(voxel_size=SIZE, association_sigmas=0.0))
    report = voxel_map.integrate([[1e-6, 0.0, 0.0], [0.0, 0.0, 0.0]], np.eye(4))
    assert report.points_used <= 2
    assert (voxel_map.voxels()[1] >= 0.0).all()


# Casting rays.


@pytest.fixture(scope="module")
def cluttered() -> VoxelMap:
    """Scattered occupied voxels and free space between them."""
    rng = np.random.default_rng(8)
    config = VoxelMapConfig(voxel_size=0.1, association_sigmas=0.0, max_range=4.0)
    voxel_map = VoxelMap(config)
    for _ in range(3):
        voxel_map.integrate(sparse_cloud(rng, 150, 2.0), random_pose(rng))
    return voxel_map


def test_rays_meet_the_first_occupied_voxel(cluttered, rng):
    indices, log_odds = cluttered.voxels()
    occupied = indices[log_odds > 0.0]
    origins = rng.uniform(-2.0, 2.0, (400, 3))
    targets = (occupied[rng.integers(len(occupied), size=400)] + rng.uniform(0, 1, (400, 3))) * 0.1
    directions = (targets - origins) * rng.uniform(0.2, 5.0, (400, 1))
    distances, hits = cluttered.first_occupied(origins, directions, 1.9)
    units = directions / np.linalg.norm(directions, axis=1, keepdims=True)
    expected = np.array(
        [ray_distance(o, d, occupied, 0.1) for o, d in zip(origins, units, strict=True)]
    )
    np.testing.assert_array_equal(hits, expected < 1.9)
    np.testing.assert_allclose(distances, np.minimum(expected, 1.9), atol=1e-9)
    assert 100 < hits.sum() < 390


def test_rays_along_the_axes(cluttered):
    indices, log_odds = cluttered.voxels()
    occupied = indices[log_odds > 0.0]
    axes = np.vstack([np.eye(3), -np.eye(3)])
    starts = (occupied[:40, None] + 0.5) * 0.1 - axes * 0.73
    directions = np.tile(axes, (40, 1))
    distances, hits = cluttered.first_occupied(starts.reshape(-1, 3), directions, 2.0)
    assert hits.all()
    expected = [
        ray_distance(o, d, occupied, 0.1)
        for o, d in zip(starts.reshape(-1, 3), directions, strict=True)
    ]
    np.testing.assert_allclose(distances, expected, atol=1e-9)


def test_a_ray_that_starts_in_an_occupied_voxel_is_there(cluttered):
    indices, log_odds = cluttered.voxels()
    inside = (indices[log_odds > 0.0][:5] + 0.3) * 0.1
    distances, hits = cluttered.first_occupied(inside, np.ones((5, 3)), 1.0)
    assert hits.all()
    np.testing.assert_array_equal(distances, 0.0)


def test_one_origin_serves_many_rays(cluttered, rng):
    directions = rng.normal(size=(50, 3))
    origin = np.array([0.1, 0.2, -0.1])
    one = cluttered.first_occupied(origin, directions, 3.0)
    many = cluttered.first_occupied(np.tile(origin, (50, 1)), directions, 3.0)
    np.testing.assert_array_equal(one, many)


@pytest.mark.parametrize("cast", [VoxelMap.cast_rays, VoxelMap.first_occupied])
def test_rays_through_an_empty_map_meet_nothing(cast):
    distances, hits = cast(VoxelMap(), [0.0, 0.0, 0.0], [[1.0, 2.0, 3.0]], 7.0)
    assert distances.tolist() == [7.0]
    assert not hits.any()


@pytest.mark.parametrize(
    ("origins", "directions", "max_range"),
    [
        ([0, 0, 0], [[0.0, 0.0, 0.0]], 1.0),
        ([0, 0, np.nan], [[1.0, 0.0, 0.0]], 1.0),
        ([0, 0, 0], [[1.0, np.inf, 0.0]], 1.0),
        ([0, 0, 0], [[1.0, 0.0]], 1.0),
        ([0, 0, 0], [[1.0, 0.0, 0.0]], 0.0),
        ([0, 0, 0], [[1.0, 0.0, 0.0]], 1e9),
        ([1e9, 0, 0], [[1.0, 0.0, 0.0]], 1.0),
        ([0, 0, 0], [[1.0, 0.0, 0.0]], np.nan),
        ([[0, 0, 0], [0, 0, 0]], [[1.0, 0.0, 0.0]] * 3, 1.0),
    ],
)
def test_impossible_rays_are_refused(origins, directions, max_range):
    for cast in (VoxelMap.cast_rays, VoxelMap.first_occupied):
        with pytest.raises(InvalidInputError):
            cast(VoxelMap(), origins, directions, max_range)


@pytest.mark.parametrize("length", [0.0, 0.02])
def test_points_on_a_line_or_in_one_place_are_associated_along_the_line_of_sight(length):
    # Neither has a normal; noise moves the points along the ray, here nearly along x.
    points = np.array([1.02, 0.02, 0.075]) + np.linspace(-0.5, 0.5, 200)[:, None] * [0, 0, length]
    points += np.random.default_rng(3).normal(0.0, 1e-4, points.shape) * (length > 0.0)
    config = VoxelMapConfig(voxel_size=SIZE, default_sigma=0.02, error_correlation=1.0)
    voxel_map = VoxelMap(config)
    voxel_map.integrate(points, np.eye(4))
    indices, log_odds = voxel_map.voxels()
    occupied = indices[log_odds > 0.0].tolist()
    assert sorted(occupied) == [[19, 0, 1], [20, 0, 1], [21, 0, 1]]
