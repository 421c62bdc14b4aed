"""Impossible scans are refused or counted, and never change the map by halves."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from infomap_ros.errors import CapacityError, InvalidInputError
from infomap_ros.geometry import PinholeCamera, make_transform
from infomap_ros.mapping import VoxelMap, VoxelMapConfig

from .scenes import random_pose, random_scene

CAMERA = PinholeCamera(24, 18, 20.0, 20.0, 11.5, 8.5)
WALL = CAMERA.back_project(np.full((18, 24), 1.3))
NAN = np.full((18, 24, 3), np.nan)
CAMERAS = pytest.mark.parametrize("camera", [CAMERA, None], ids=["camera", "rays"])


def mapped(**parameters: float) -> VoxelMap:
    voxel_map = VoxelMap(VoxelMapConfig(voxel_size=0.1, max_range=3.0, **parameters))
    voxel_map.integrate(WALL, np.eye(4), camera=CAMERA)
    return voxel_map


def assert_unchanged(voxel_map: VoxelMap, state: dict[str, np.ndarray]) -> None:
    for name, array in voxel_map.state().items():
        np.testing.assert_array_equal(array, state[name], err_msg=name)


def turned(pitch: float) -> np.ndarray:
    c, s = np.cos(pitch), np.sin(pitch)
    return make_transform([[1, 0, 0], [0, c, -s], [0, s, c]], [0.0, 0.0, 0.0])


ASYMMETRIC = np.eye(6) * 1e-4 + np.triu(np.ones((6, 6)), 1) * 1e-5
SHEARED = np.eye(4) + np.diag([0.1, 0.0, 0.0], 1)


@pytest.mark.parametrize(
    ("name", "arguments"),
    [
        ("points", {"points": np.zeros(3)}),
        ("points", {"points": np.zeros((4, 2))}),
        ("points", {"points": np.zeros((18, 23, 3))}),
        ("points", {"points": np.zeros((1, 18, 24, 3))}),
        ("points", {"points": [[1.0, 2.0, 3.0], [1.0]]}),
        ("points", {"points": "cloud"}),
        ("T_map_sensor", {"T_map_sensor": np.eye(3)}),
        ("T_map_sensor", {"T_map_sensor": np.eye(4) * 2.0}),
        ("T_map_sensor", {"T_map_sensor": SHEARED}),
        ("T_map_sensor", {"T_map_sensor": np.diag([1.0, 1.0, -1.0, 1.0])}),
        ("T_map_sensor", {"T_map_sensor": np.full((4, 4), np.nan)}),
        ("covariances", {"covariances": np.ones((18, 24, 3))}),
        ("covariances", {"covariances": np.ones((3, 3))}),
        ("covariances", {"covariances": [[1.0], [1.0, 2.0]]}),
        ("pose_covariance", {"pose_covariance": np.eye(3)}),
        ("pose_covariance", {"pose_covariance": ASYMMETRIC}),
        ("pose_covariance", {"pose_covariance": np.diag([1.0, 1, 1, 1, 1, -1])}),
        ("pose_covariance", {"pose_covariance": np.full((6, 6), np.inf)}),
        ("error_correlation", {"error_correlation": 1.5}),
        ("error_correlation", {"error_correlation": float("nan")}),
    ],
)
def test_impossible_arguments_are_refused_by_name(name, arguments):
    voxel_map = mapped()
    state = voxel_map.state()
    with pytest.raises(InvalidInputError) as refusal:
        voxel_map.integrate(
            **({"points": WALL, "T_map_sensor": np.eye(4), "camera": CAMERA} | arguments)
        )
    assert refusal.value.name == name
    assert_unchanged(voxel_map, state)


@CAMERAS
@pytest.mark.parametrize("points", [NAN, np.full((18, 24, 3), np.inf), np.zeros((18, 24, 3))])
def test_a_cloud_without_measurement_changes_nothing(points, camera):
    voxel_map = mapped()
    state = voxel_map.state()
    report = voxel_map.integrate(points, np.eye(4), camera=camera)
    assert (report.points_used, report.voxels_observed) == (0, 0)
    assert_unchanged(voxel_map, state)


@CAMERAS
def test_an_empty_cloud_changes_nothing(camera):
    voxel_map = mapped()
    state = voxel_map.state()
    report = voxel_map.integrate(np.zeros((0, 3)), np.eye(4), camera=camera)
    assert (report.points_used, report.points_out_of_range, report.points_refused) == (0, 0, 0)
    assert_unchanged(voxel_map, state)


@CAMERAS
@pytest.mark.parametrize("variance", [0.0, -1e-4, np.nan, np.inf])
def test_points_with_an_impossible_covariance_are_counted(camera, variance):
    covariances = np.tile(np.eye(3) * 1e-4, (18, 24, 1, 1))
    covariances[5:9, :, 1, 1] = variance
    voxel_map = VoxelMap(VoxelMapConfig(voxel_size=0.1))
    report = voxel_map.integrate(WALL, np.eye(4), covariances, camera=camera)
    assert report.points_refused == 4 * 24
    assert report.points_used == 14 * 24
    assert np.isfinite(voxel_map.gaussians()[2]).all()


@CAMERAS
def test_a_covariance_that_is_not_positive_as_a_whole_gives_no_gaussian(camera):
    indefinite = np.tile(np.array([[1.0, 3.0, 0.0], [3.0, 1.0, 0.0], [0.0, 0.0, 1.0]]), (432, 1, 1))
    voxel_map = VoxelMap(VoxelMapConfig(voxel_size=0.1))
    report = voxel_map.integrate(WALL.reshape(-1, 3), np.eye(4), indefinite, camera=camera)
    assert report.voxels_observed == 0
    assert voxel_map.surface_voxels == 0


@CAMERAS
def test_points_out_of_range_are_counted_and_free_space(camera):
    voxel_map = VoxelMap(VoxelMapConfig(voxel_size=0.1, max_range=1.0))
    report = voxel_map.integrate(WALL, np.eye(4), camera=camera)
    assert (report.points_used, report.points_out_of_range) == (0, WALL[..., 0].size)
    assert voxel_map.surface_voxels == 0
    assert (voxel_map.log_odds([[0.05, 0.05, 0.55]]) < 0.0).all()


@CAMERAS
@pytest.mark.parametrize("distance", [1e5, 1e6, 1e12, -1e12])
def test_a_scan_from_beyond_the_coordinates_is_refused(camera, distance):
    voxel_map = VoxelMap(VoxelMapConfig(voxel_size=0.05))
    pose = make_transform(np.eye(3), [distance, 0.0, 0.0])
    with pytest.raises(InvalidInputError, match=r"T_map_sensor.*a map ends at 52428\.8 m"):
        voxel_map.integrate(WALL, pose, camera=camera)
    assert voxel_map.known_voxels == 0


@CAMERAS
def test_points_beyond_the_coordinates_are_counted(camera):
    voxel_map = VoxelMap(VoxelMapConfig(voxel_size=0.05))
    pose = make_transform([[0, 0, 1], [0, 1, 0], [-1, 0, 0]], [2**20 * 0.05 - 1e-3, 0.0, 0.0])
    report = voxel_map.integrate(WALL, pose, camera=camera)
    assert report.points_used == 0
    assert report.points_refused == WALL[..., 0].size


@CAMERAS
@pytest.mark.parametrize("overlap", [-0.4, 0.0, 0.7, 1.5])
def test_a_scan_across_the_limit_of_the_coordinates_stays_within(camera, overlap):
    size = 0.05
    edge = (2**20 - 128) * size
    pose = make_transform([[0, 0, -1], [0, 1, 0], [1, 0, 0]], [edge + overlap, 0.0, 0.0])
    voxel_map = VoxelMap(VoxelMapConfig(voxel_size=size))
    voxel_map.integrate(WALL, pose, camera=camera)
    indices, _ = voxel_map.voxels()
    assert (np.abs(indices) < 2**20).all()
    distances = np.linalg.norm((indices + 0.5) * size - pose[:3, 3], axis=1)
    assert distances.max(initial=0.0) < 2.5


def test_points_that_the_camera_cannot_have_seen_are_counted():
    points = np.array([[0.0, 0.0, 1.0], [9.0, 0.0, 1.0], [0.0, 0.0, -1.0], [np.nan, 0.0, 1.0]])
    voxel_map = VoxelMap(VoxelMapConfig(voxel_size=0.1))
    report = voxel_map.integrate(points, np.eye(4), camera=CAMERA)
    assert (report.points_used, report.points_refused) == (1, 2)


def test_points_in_any_order_are_put_into_their_pixels(rng):
    pose = random_pose(rng)
    points = random_scene(rng).points(CAMERA, pose)
    shuffled = points.reshape(-1, 3)[rng.permutation(432)[:400]]
    kept = np.isin(points.reshape(-1, 3)[:, 0], shuffled[:, 0]).reshape(18, 24)
    organized = np.where(kept[..., None], points, np.float32(np.nan))
    config = VoxelMapConfig(voxel_size=0.1, max_range=3.0)
    one, other = VoxelMap(config), VoxelMap(config)
    one.integrate(shuffled, pose, camera=CAMERA)
    other.integrate(organized, pose, camera=CAMERA)
    for a, b in zip(one.voxels(), other.voxels(), strict=True):
        np.testing.assert_array_equal(a, b)


@CAMERAS
def test_a_scan_beyond_the_memory_limit_leaves_the_map_as_it_was(camera):
    rng = np.random.default_rng(0)
    fine = PinholeCamera(160, 120, 100.0, 100.0, 79.5, 59.5)
    scene = random_scene(rng)
    voxel_map = VoxelMap(VoxelMapConfig(voxel_size=0.03, max_range=3.0, memory_limit=0.002))
    with pytest.raises(CapacityError, match=r"limit of 0\.002 GB"):
        for _ in range(50):
            state, pose = voxel_map.state(), random_pose(rng)
            voxel_map.integrate(scene.points(fine, pose), pose, camera=camera and fine)
    assert_unchanged(voxel_map, state)
    assert voxel_map.memory_bytes() <= 2e6
    before = voxel_map.memory_bytes()
    voxel_map.integrate(np.full((1, 3), 0.01), np.eye(4))
    assert voxel_map.memory_bytes() >= before


@CAMERAS
def test_a_scan_that_sees_more_than_memory_holds_is_refused(camera):
    voxel_map = VoxelMap(VoxelMapConfig(voxel_size=0.005, max_range=10.0, memory_limit=0.001))
    far = CAMERA.back_project(np.full((18, 24), 40.0))
    with pytest.raises(CapacityError, match="limit"):
        voxel_map.integrate(far, np.eye(4), camera=camera)
    assert voxel_map.known_voxels == 0


strange = st.sampled_from(
    [0.0, -0.0, 1e-45, 1e-30, 1e-20, 1e-9, 0.05, 1.0, 2.9999, 3.0, 1e5, 1e19, 3e38, np.inf, np.nan]
)
coordinates = st.one_of(
    strange, strange.map(lambda x: -x), st.floats(width=32, allow_subnormal=True)
)


@CAMERAS
@settings(max_examples=150, deadline=None)
@given(
    points=arrays.arrays(np.float32, (6, 8, 3), elements=coordinates),
    variances=arrays.arrays(np.float32, (6, 8, 6), elements=coordinates, fill=st.just(1e-4)),
    offset=st.sampled_from([0.0, 1e4, 104857.0, 1e9]),
)
def test_no_numbers_bring_the_map_down(camera, points, variances, offset):
    small = PinholeCamera(8, 6, 6.0, 6.0, 3.5, 2.5) if camera else None
    voxel_map = VoxelMap(VoxelMapConfig(voxel_size=0.1, max_range=3.0))
    pose = make_transform(turned(0.3)[:3, :3], [offset, -offset, offset])
    if offset == 1e9:
        with pytest.raises(InvalidInputError, match="a map ends"):
            voxel_map.integrate(points, pose, None, np.eye(6) * 1e-6, small)
        return
    for covariances in (None, variances):
        report = voxel_map.integrate(points, pose, covariances, np.eye(6) * 1e-6, small)
        assert 0 <= report.points_used <= 48
    indices, log_odds = voxel_map.voxels()
    assert (np.abs(indices) < 2**20).all()
    assert np.isfinite(log_odds).all()
    distances = np.linalg.norm((indices + 0.5) * 0.1 - pose[:3, 3], axis=1)
    assert distances.max(initial=0.0) < 3.0 + 8 * 0.1 * 2
    _, means, covariances = voxel_map.gaussians()
    assert np.isfinite(means).all() and np.isfinite(covariances).all()


def test_points_behind_another_in_their_pixel_are_counted() -> None:
    near = WALL.reshape(-1, 3)[[40, 41, 42]]
    report = mapped().integrate(np.concatenate([near, 1.5 * near]), np.eye(4), camera=CAMERA)
    assert (report.points_used, report.points_refused) == (3, 3)
