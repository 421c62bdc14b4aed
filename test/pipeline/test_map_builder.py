"""A map that follows keyframes, whenever there is time for that."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from infomap_ros.errors import FrameError
from infomap_ros.geometry import (
    PinholeCamera,
    PlacedSolid,
    PointCloudRecord,
    PoseRecord,
    PoseUncertainty,
    Sphere,
)
from infomap_ros.geometry.assumed_pose import AssumedPoseConfig
from infomap_ros.mapping import VoxelMap, VoxelMapConfig
from infomap_ros.mapping.correction.scan_store import ScanStoreConfig
from infomap_ros.messages.motions import KeyframePoses
from infomap_ros.pipeline.map_builder import MapBuilder
from infomap_ros.pipeline.scan_synchronizer import Scan

from .map_hash import map_hash

CAMERA = PinholeCamera(64, 48, 60.0, 60.0, 31.5, 23.5)
COVARIANCE = 1e-6 * np.eye(6)


def scan(number: int, covariance: np.ndarray | None = COVARIANCE) -> Scan[PointCloudRecord]:
    points = CAMERA.back_project(np.full((48, 64), 1.5))
    covariances = np.broadcast_to(np.float32(1e-4) * np.eye(3, dtype=np.float32), (48, 64, 3, 3))
    cloud = PointCloudRecord(number, "camera", points, covariances, error_correlation=0.25)
    return Scan(cloud, PoseRecord(number, "map", np.eye(4), covariance))


def keyframes(as_of: int, *shifts: float) -> KeyframePoses:
    poses = np.tile(np.eye(4), (len(shifts), 1, 1))
    poses[:, 0, 3] = shifts
    return KeyframePoses(as_of, "map", np.arange(len(shifts)), poses)


def builder(store: ScanStoreConfig | None = None) -> MapBuilder:
    return MapBuilder(VoxelMap(VoxelMapConfig(voxel_size=0.05)), store)


@pytest.mark.parametrize("shifts", [(0.3, 0.02), (0.04, 0.0), (0.3, 0.6)])
def test_the_map_does_not_depend_on_when_it_is_corrected(shifts: tuple[float, float]) -> None:
    told = [keyframes(4, 0.0, 0.0), keyframes(5, shifts[0], 0.0), keyframes(6, shifts[1], 0.0)]
    at_once, later = builder(ScanStoreConfig()), builder(ScanStoreConfig())
    for each in (at_once, later):
        for number in range(2):
            each.fuse(scan(number))
    for poses in told:
        at_once.add_keyframes(poses)
        at_once.correct()
        later.add_keyframes(poses)
    later.correct()
    assert at_once.corrections == later.corrections > 0
    assert map_hash(at_once.map) == map_hash(later.map)


def test_the_clouds_own_correlation_counts() -> None:
    built = builder()
    built.fuse(scan(0))
    expected = VoxelMap(VoxelMapConfig(voxel_size=0.05, error_correlation=0.25))
    cloud = scan(0).cloud
    expected.integrate(cloud.points, np.eye(4), cloud.covariances, COVARIANCE, CAMERA)
    np.testing.assert_allclose(built.map.gaussians()[2], expected.gaussians()[2], rtol=1e-4)


def test_a_pose_without_covariance_is_not_taken_for_exact() -> None:
    assumed, told = builder(), builder()
    assumed.fuse(scan(0, None))
    told.fuse(scan(0, AssumedPoseConfig().covariance()))
    assert (assumed.assumed_poses, told.assumed_poses) == (1, 0)
    assert map_hash(assumed.map) == map_hash(told.map)


def test_points_on_a_body_are_counted_and_left_out() -> None:
    built, before = builder(), scan(0)
    place = np.eye(4)
    place[2, 3] = 1.5
    built.fuse(Scan(before.cloud, before.pose, [PlacedSolid(Sphere(0.2), place)]))
    assert built.points_cut > 50
    assert not built.map.is_known([[0.0, 0.0, 1.5]])[0]


def of_origin(origin: int, number: int) -> Scan[PointCloudRecord]:
    known = PoseUncertainty(COVARIANCE, origin=origin)
    pose = PoseRecord(number, "map", np.eye(4), COVARIANCE, uncertainty=known)
    return Scan(scan(number).cloud, pose)


def test_poses_of_another_origin_do_not_enter_the_map() -> None:
    built = builder(ScanStoreConfig())
    built.fuse(of_origin(7, 0))
    before = map_hash(built.map)

    for foreign in (8, 0):
        with pytest.raises(FrameError, match=r"origin is 00000007"):
            built.fuse(of_origin(foreign, 1))
        with pytest.raises(FrameError, match="keyframe_poses"):
            built.add_keyframes(replace(keyframes(4, 0.3), origin=foreign))
    assert map_hash(built.map) == before

    built.fuse(of_origin(7, 2))
    built.replace(VoxelMap(built.map.config))
    built.fuse(of_origin(8, 3))
    assert built.map.origin == 8


def test_the_origin_outlives_corrections_and_the_map_file(tmp_path: Path) -> None:
    built = builder(ScanStoreConfig())
    built.fuse(of_origin(7, 0))
    built.add_keyframes(replace(keyframes(4, 0.0), origin=7))
    built.add_keyframes(replace(keyframes(5, 0.3), origin=7))
    built.correct()
    assert built.corrections == 1
    built.map.save(tmp_path / "map")
    built.replace(VoxelMap.load(tmp_path / "map"))
    with pytest.raises(FrameError, match="origin"):
        built.fuse(of_origin(8, 1))
