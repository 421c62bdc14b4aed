"""Which way scans move when the poses of keyframes are corrected, and that the map follows."""

from __future__ import annotations

import numpy as np
import pytest

from infomap_ros.errors import InvalidInputError
from infomap_ros.geometry import PinholeCamera, perturb_transform
from infomap_ros.mapping import VoxelMap, VoxelMapConfig
from infomap_ros.mapping.correction.correctable_map import CorrectableMap, PoseCorrections
from infomap_ros.mapping.correction.scan_store import ScanStoreConfig, integrate_record
from test.mapping.scenes import Scene, look_at
from test.mapping.voxels import voxels_of

CAMERA = PinholeCamera(64, 48, 50.0, 50.0, 31.5, 23.5)
CONFIG = VoxelMapConfig(voxel_size=0.08, max_range=3.0)


def _poses(count: int, seed: int = 0, spread: float = 1.0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return np.stack([perturb_transform(np.eye(4), rng.normal(0, spread, 6)) for _ in range(count)])


def test_a_scan_of_a_keyframe_takes_its_pose() -> None:
    corrections, old, new = PoseCorrections(), _poses(3), _poses(3, seed=1)
    for stamp, pose in zip((10, 20, 30), old, strict=True):
        corrections.add(stamp, pose)
    corrections.receive_poses(30, [10, 20, 30], old)
    corrections.receive_poses(40, [10, 20, 30], new)
    found = np.stack([corrections.poses[stamp, ""][0] for stamp in (10, 20, 30)])
    assert np.array_equal(found, new)


def test_a_scan_between_keyframes_keeps_its_place_beside_the_one_before() -> None:
    corrections, old, new = PoseCorrections(), _poses(2), _poses(2, seed=1)
    (between,) = _poses(1, seed=2)
    corrections.add(15, between)
    corrections.receive_poses(20, [10, 20], old)
    corrections.receive_poses(40, [10, 20], new)
    relative = np.linalg.inv(old[0]) @ between
    assert np.allclose(np.linalg.inv(new[0]) @ corrections.poses[15, ""][0], relative)


def test_sensors_that_measure_with_a_keyframe_move_as_one_body() -> None:
    corrections, old, new = PoseCorrections(), _poses(2), _poses(2, seed=1)
    (T_camera_lidar,) = _poses(1, seed=2)
    for stamp, pose in zip((10, 20), old, strict=True):
        corrections.add(stamp, pose)
        corrections.add(stamp, pose @ T_camera_lidar, "lidar")
    corrections.receive_poses(20, [10, 20], old)
    corrections.receive_poses(40, [10, 20], new)
    for stamp, pose in zip((10, 20), new, strict=True):
        assert np.array_equal(corrections.poses[stamp, ""][0], pose)
        assert np.allclose(corrections.poses[stamp, "lidar"][0], pose @ T_camera_lidar)


def test_a_scan_after_the_correction_stays() -> None:
    corrections, (pose,) = PoseCorrections(), _poses(1, seed=3)
    corrections.receive_poses(20, [10, 20], _poses(2))
    corrections.receive_poses(40, [10, 20], _poses(2, seed=1))
    for stamp in (40, 41):
        corrections.add(stamp, pose)
        assert np.array_equal(corrections.poses[stamp, ""][0], pose)
    corrections.receive_poses(40, [10, 20], _poses(2, seed=2))
    assert np.array_equal(corrections.poses[41, ""][0], pose)


def test_a_scan_that_comes_late_is_corrected_as_if_it_had_come_in_time() -> None:
    (pose,) = _poses(1, seed=3)
    in_time, late = PoseCorrections(), PoseCorrections()
    in_time.add(25, pose)
    for corrections in (in_time, late):
        corrections.receive_poses(20, [10, 20], _poses(2))
        corrections.receive_poses(40, [10, 20], _poses(2, seed=1))
        corrections.receive_poses(50, [10, 20, 40], _poses(3, seed=2))
    late.add(25, pose)
    assert np.allclose(in_time.poses[25, ""][0], late.poses[25, ""][0])
    assert not np.allclose(in_time.poses[25, ""][0], pose)


def test_a_keyframe_that_is_no_longer_kept_moves_with_its_neighbor() -> None:
    corrections, (pose,) = PoseCorrections(), _poses(1, seed=3)
    old = _poses(3)
    corrections.add(15, pose)
    corrections.receive_poses(30, [10, 15, 30], old)
    corrections.receive_poses(40, [10, 30], old[[0, 2]])
    assert np.array_equal(corrections.poses[15, ""][0], pose)
    new = _poses(2, seed=1)
    corrections.receive_poses(50, [10, 30], new)
    expected = new[0] @ np.linalg.inv(old[0]) @ pose
    assert np.allclose(corrections.poses[15, ""][0], expected)


def test_when_time_goes_backwards_scans_stay_where_they_are() -> None:
    corrections, (pose,) = PoseCorrections(), _poses(1, seed=3)
    corrections.add(15, pose)
    corrections.receive_poses(30, [10, 20], _poses(2))
    corrections.receive_poses(5, [10, 20], _poses(2, seed=1))
    assert np.array_equal(corrections.poses[15, ""][0], pose)


def test_other_keyframes_after_a_restart_move_nothing() -> None:
    corrections, (pose,) = PoseCorrections(), _poses(1, seed=3)
    corrections.add(15, pose)
    corrections.receive_poses(30, [10, 20], _poses(2))
    corrections.receive_poses(60, [50, 60], _poses(2, seed=1))
    assert np.array_equal(corrections.poses[15, ""][0], pose)


def test_keyframe_poses_that_are_none_are_refused() -> None:
    with pytest.raises(InvalidInputError, match="keyframe"):
        PoseCorrections().receive_poses(1, [1], np.ones((1, 4, 4)))
    with pytest.raises(InvalidInputError, match="stamps"):
        PoseCorrections().receive_poses(1, [1, 2], _poses(1))


def _drive(**store: float) -> tuple[CorrectableMap, list[np.ndarray], list[np.ndarray]]:
    """Ten scans along a wall with a pose that drifts, and the true poses."""
    scene = Scene([(0.0, 1.0, 0.0, 1.5), (0.0, 0.0, 1.0, -0.6)], [(2.0, 1.2, 0.0, 0.3)])
    true = [look_at([0.3 * i, 0.0, 0.0], [0.3 * i + 0.5, 1.5, -0.4]) for i in range(10)]
    drift = [perturb_transform(np.eye(4), 0.03 * i * np.ones(6)) for i in range(10)]
    used = [error @ pose for error, pose in zip(drift, true, strict=True)]
    correctable = CorrectableMap(VoxelMap(CONFIG), ScanStoreConfig(**store))
    for stamp, (pose, truth) in enumerate(zip(used, true, strict=True)):
        points = scene.points(CAMERA, truth)
        correctable.integrate(stamp, points, pose, camera=CAMERA)
    return correctable, true, used


def test_the_map_follows_the_keyframes() -> None:
    correctable, true, used = _drive()
    correctable.receive_poses(9, np.arange(10), used)
    assert not correctable.begin_correction()
    correctable.receive_poses(12, np.arange(10), true)
    report = correctable.correct()
    expected = VoxelMap(CONFIG)
    for scan, pose in zip(correctable.store, true, strict=True):
        within = np.allclose(scan.transform, pose)
        moved_little = np.linalg.norm(scan.transform[:3, 3] - pose[:3, 3]) < 0.08
        assert within or moved_little
        integrate_record(expected, scan.record, scan.transform, scan.uncertainty)
    assert report is not None and report.scans_moved >= 8
    assert voxels_of(correctable.voxel_map) == voxels_of(expected)
    assert not correctable.begin_correction()


def test_scans_of_two_sensors_of_one_moment_are_both_put_where_they_belong() -> None:
    scene, correctable = Scene([(0.0, 1.0, 0.0, 1.5)]), CorrectableMap(VoxelMap(CONFIG))
    true = look_at([0.0, 0.0, 0.0], [0.2, 1.5, 0.1])
    wrong = perturb_transform(true, 0.1 * np.ones(6))
    mount = perturb_transform(np.eye(4), [0.4, -0.2, 0.1, 0.1, 0.3, -0.2])
    for sensor, place in (("", np.eye(4)), ("lidar", mount)):
        points = scene.points(CAMERA, true @ place)
        correctable.integrate(5, points, wrong @ place, camera=CAMERA, sensor=sensor)
    correctable.receive_poses(5, [5], wrong[None])
    correctable.receive_poses(9, [5], true[None])
    report = correctable.correct()
    assert report is not None and report.scans_moved == 2
    of_camera, of_lidar = (scan.transform for scan in correctable.store)
    assert np.allclose(of_camera, true) and np.allclose(of_lidar, true @ mount)
    assert np.allclose(correctable.voxel_map.gaussians()[1][:, 1], 1.5, atol=0.01)


def test_the_map_can_be_used_while_it_is_corrected() -> None:
    correctable, true, used = _drive()
    before = voxels_of(correctable.voxel_map)
    correctable.receive_poses(9, np.arange(10), used)
    correctable.receive_poses(12, np.arange(10), true)
    assert correctable.begin_correction()
    assert correctable.correct_more() is None
    assert correctable.is_correcting
    assert voxels_of(correctable.voxel_map) == before


def test_a_map_that_keeps_no_scans_stays_as_it_is() -> None:
    correctable, true, used = _drive(memory=0.0)
    correctable.receive_poses(9, np.arange(10), used)
    correctable.receive_poses(12, np.arange(10), true)
    assert correctable.correct() is None
    assert correctable.voxel_map.known_voxels > 0


def test_scans_are_not_frozen_while_the_map_is_corrected() -> None:
    whole, true, used = _drive()
    size = sum(scan.record.memory_bytes() for scan in whole.store)
    tight, _, _ = _drive(memory=(size + 100) * 1e-9)
    assert tight.store.frozen == 0
    tight.receive_poses(9, np.arange(10), used)
    tight.receive_poses(12, np.arange(10), true)
    assert tight.begin_correction()
    points = Scene([(0.0, 1.0, 0.0, 1.5)]).points(CAMERA, true[0])
    for stamp in range(13, 17):
        tight.integrate(stamp, points, true[0], camera=CAMERA)
    assert tight.store.frozen == 0
    assert tight.correct() is not None
    assert tight.store.frozen > 0
    expected = VoxelMap.from_state(CONFIG, tight.store.base.state())
    for scan in tight.store:
        integrate_record(expected, scan.record, scan.transform, scan.uncertainty)
    evidence = [{i: v[0] for i, v in voxels_of(m).items()} for m in (tight.voxel_map, expected)]
    assert evidence[0] == evidence[1]
