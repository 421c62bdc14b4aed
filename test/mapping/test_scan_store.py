"""Keeping scans: what comes out again, how much memory it takes, what is given up first."""

from __future__ import annotations

import numpy as np
import pytest

from infomap_ros.errors import CapacityError, InvalidInputError
from infomap_ros.geometry import PinholeCamera, PoseUncertainty
from infomap_ros.mapping import VoxelMap, VoxelMapConfig
from infomap_ros.mapping.correction.scan_record import keep_scan
from infomap_ros.mapping.correction.scan_store import ScanStore, ScanStoreConfig
from infomap_ros.mapping.scans.view_volume import mark_blocks, view_volume
from infomap_ros.mapping.voxels.keys import pack
from infomap_ros.stereo import DepthCameraConfig, DepthCameraSensor
from test.mapping.scenes import look_at, random_scene
from test.mapping.voxels import voxels_of

CAMERA = PinholeCamera(96, 72, 80.0, 82.0, 46.3, 36.9)
CONFIG = VoxelMapConfig(voxel_size=0.05, max_range=3.0)


def _cloud(seed: int = 0):  # type: ignore[no-untyped-def]
    """A noisy cloud of a depth camera in a random room."""
    rng = np.random.default_rng(seed)
    pose = look_at(np.zeros(3), rng.normal(size=3))
    depth = random_scene(rng).points(CAMERA, pose)[..., 2]
    depth[rng.random(depth.shape) < 0.1] = np.nan
    return DepthCameraSensor(CAMERA, DepthCameraConfig()).measure(depth.astype(np.float32)), pose


@pytest.mark.parametrize("seed", range(4))
def test_a_kept_depth_image_is_within_a_fraction_of_its_noise(seed: int) -> None:
    cloud, _ = _cloud(seed)
    kept = keep_scan(cloud.organized_points, cloud.covariance_triangles, CAMERA).restore()
    valid = cloud.valid
    assert np.array_equal(valid, np.isfinite(kept.points).all(axis=-1))
    sigma = np.sqrt(cloud.covariance_triangles[valid][:, 5])
    error = np.abs(kept.points[valid][:, 2] - cloud.range_image[valid])
    assert np.quantile(error / sigma, 0.99) < 0.15
    assert np.sqrt(np.mean((error / sigma) ** 2)) < 0.08
    assert kept.covariances is not None
    ratio = kept.covariances[valid][:, [0, 3, 5]] / cloud.covariance_triangles[valid][:, [0, 3, 5]]
    assert np.abs(ratio - 1.0).max() < 0.06


def test_a_scan_is_the_same_each_time_it_is_taken_out() -> None:
    cloud, _ = _cloud()
    record = keep_scan(cloud.organized_points, cloud.organized_covariances, CAMERA, 0.2)
    first, second = record.restore(), record.restore()
    assert np.array_equal(first.points, second.points, equal_nan=True)
    assert first.error_correlation == 0.2


def test_covariances_that_no_depth_image_has_are_kept_as_they_are() -> None:
    cloud, _ = _cloud()
    other = cloud.organized_covariances.copy()
    other[..., 0, 2] *= 0.5
    other[..., 2, 0] *= 0.5
    kept = keep_scan(cloud.organized_points, other, CAMERA).restore()
    assert np.array_equal(kept.covariances, other, equal_nan=True)
    assert np.array_equal(kept.points, cloud.organized_points, equal_nan=True)


def test_an_unorganized_cloud_is_kept_as_it_is() -> None:
    points = np.random.default_rng(1).normal(size=(500, 3)).astype(np.float32)
    kept = keep_scan(points).restore()
    assert np.array_equal(kept.points, points)
    assert kept.covariances is None and kept.camera is None


def test_a_scan_without_any_measurement_is_kept() -> None:
    nothing = np.full((CAMERA.height, CAMERA.width, 3), np.nan, np.float32)
    record = keep_scan(nothing, np.full((*nothing.shape[:2], 6), np.nan, np.float32), CAMERA)
    assert np.isnan(record.restore().points).all()
    assert record.farthest == 0.0


def test_a_kept_scan_takes_a_tenth_of_its_cloud() -> None:
    cloud, _ = _cloud()
    record = keep_scan(cloud.organized_points, cloud.covariance_triangles, CAMERA)
    assert record.memory_bytes() < 0.1 * 36 * CAMERA.width * CAMERA.height + 1000


@pytest.mark.parametrize("organized", [True, False])
def test_no_block_that_a_scan_touches_is_missed(organized: bool) -> None:
    for seed in range(8):
        cloud, pose = _cloud(seed)
        pose = pose.copy()
        pose[:3, 3] = np.random.default_rng(seed).uniform(-0.5, 0.5, 3)
        voxel_map, store = VoxelMap(CONFIG), ScanStore(CONFIG)
        points, spread = cloud.organized_points, cloud.covariance_triangles
        camera = CAMERA if organized else None
        if not organized:
            points, spread = cloud.points, cloud.covariances
        store.integrate(voxel_map, seed, points, pose, spread, np.eye(6) * 1e-4, camera)
        (scan,) = store
        keys = voxel_map.state()["block_keys"]
        marks = np.zeros(len(keys), np.bool_)
        volume = view_volume(pose, camera, scan.record.farthest, CONFIG)
        mark_blocks(volume, CONFIG, keys, marks)
        assert len(keys) > 10
        assert marks.all()


def test_a_view_volume_leaves_out_what_lies_behind_the_camera() -> None:
    keys = np.array([pack(block, 0, 0) for block in (-7, 6)])
    pose = look_at(np.zeros(3), np.array([1.0, 0.0, 0.0]))
    marks = np.zeros(len(keys), np.bool_)
    mark_blocks(view_volume(pose, CAMERA, 3.0, CONFIG), CONFIG, keys, marks)
    assert marks.tolist() == [False, True]


def test_the_map_gets_what_is_kept() -> None:
    cloud, pose = _cloud()
    first, second, store = VoxelMap(CONFIG), VoxelMap(CONFIG), ScanStore(CONFIG)
    store.integrate(
        first, 1, cloud.organized_points, pose, cloud.covariance_triangles, None, CAMERA
    )
    (scan,) = store
    kept = scan.record.restore()
    second.integrate(kept.points, pose, kept.covariances, None, CAMERA)
    assert voxels_of(first) == voxels_of(second)


def test_scans_beyond_the_memory_are_frozen_and_stay_in_the_base() -> None:
    clouds = [_cloud(seed) for seed in range(4)]
    sizes = [
        keep_scan(c.organized_points, c.covariance_triangles, CAMERA).memory_bytes()
        for c, _ in clouds
    ]
    store = ScanStore(CONFIG, ScanStoreConfig(memory=(sum(sizes[2:]) + 10) * 1e-9))
    voxel_map = VoxelMap(CONFIG)
    for stamp, (cloud, pose) in enumerate(clouds):
        store.integrate(
            voxel_map, stamp, cloud.organized_points, pose, cloud.covariance_triangles,
            np.eye(6) * 1e-6, CAMERA,
        )  # fmt: skip
        store.freeze_excess()
    assert store.frozen == 2
    assert [scan.stamp for scan in store] == [2, 3]
    expected, all_scans = VoxelMap(CONFIG), ScanStore(CONFIG)
    for stamp, (cloud, pose) in enumerate(clouds[:2]):
        all_scans.integrate(
            expected, stamp, cloud.organized_points, pose, cloud.covariance_triangles,
            np.eye(6) * 1e-6, CAMERA,
        )  # fmt: skip
    assert voxels_of(store.base) == voxels_of(expected)


def test_the_scan_with_the_best_known_pose_is_frozen_first() -> None:
    cloud, pose = _cloud()
    record = keep_scan(cloud.organized_points, cloud.covariance_triangles, CAMERA)
    store = ScanStore(CONFIG, ScanStoreConfig(memory=2.5 * record.memory_bytes() * 1e-9))
    for stamp, sigma in enumerate([0.3, 0.001, 0.2]):
        store.add(stamp, record, pose, PoseUncertainty(np.eye(6) * sigma**2))
    store.freeze_excess()
    assert [scan.stamp for scan in store] == [0, 2]


def test_a_scan_that_the_base_has_no_room_for_is_kept(monkeypatch) -> None:  # type: ignore[no-untyped-def]
    cloud, pose = _cloud()
    record = keep_scan(cloud.organized_points, cloud.covariance_triangles, CAMERA)
    store = ScanStore(CONFIG, ScanStoreConfig(memory=0.5 * record.memory_bytes() * 1e-9))
    store.add(1, record, pose)

    def full(*_: object) -> None:
        raise CapacityError("full")

    monkeypatch.setattr(VoxelMap, "integrate", full)
    assert store.freeze_excess() == 0
    assert [scan.stamp for scan in store] == [1]
    monkeypatch.undo()
    assert store.freeze_excess() == 1
    assert store.base.known_voxels > 0


def test_without_memory_for_scans_nothing_is_kept() -> None:
    cloud, pose = _cloud()
    store = ScanStore(CONFIG, ScanStoreConfig(memory=0.0))
    store.integrate(VoxelMap(CONFIG), 1, cloud.organized_points, pose, camera=CAMERA)
    assert len(store) == 0


def test_a_scan_that_the_map_refuses_is_not_kept() -> None:
    cloud, pose = _cloud()
    store = ScanStore(CONFIG)
    with pytest.raises(InvalidInputError):
        store.integrate(VoxelMap(CONFIG), 1, cloud.organized_points, pose, np.zeros((3, 3)))
    with pytest.raises(InvalidInputError):
        store.integrate(VoxelMap(CONFIG), 1, cloud.organized_points[..., :2], pose)
    assert len(store) == 0
