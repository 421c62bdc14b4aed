"""A map is moved to another frame when its keyframes are given there, all at once."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from infomap_ros.errors import FrameError
from infomap_ros.exploration.mission import Mission, look_poses
from infomap_ros.exploration.robot import KnownPlace
from infomap_ros.geometry import PointCloudRecord, PoseRecord, perturb_transform
from infomap_ros.geometry.pose_uncertainty import PoseUncertainty
from infomap_ros.mapping import VoxelMap, VoxelMapConfig
from infomap_ros.mapping.correction.scan_store import ScanStoreConfig
from infomap_ros.messages.motions import KeyframePoses
from infomap_ros.pipeline.map_builder import MapBuilder
from infomap_ros.pipeline.scan_synchronizer import Scan

OURS, THEIRS = 2 << 16 | 1, 1 << 16 | 4
MOVE = perturb_transform(np.eye(4), [1.2, -0.6, 0.1, 0.0, 0.0, 0.7])
NO_ERROR = 1e-8 * np.eye(6)
SIZE = 0.1


def scan(stamp: int, pose: np.ndarray, origin: int) -> Scan:
    y, z = np.mgrid[-1:1:0.03, -0.6:0.6:0.03]
    points = np.stack([np.full(y.size, 2.0), y.ravel(), z.ravel()], axis=-1).astype(np.float32)
    cloud = PointCloudRecord(stamp, "camera", points, None, None)
    parts = PoseUncertainty(NO_ERROR, NO_ERROR, 0.0 * NO_ERROR, 0.0, origin)
    return Scan(cloud, PoseRecord(stamp, "map", pose, 2.0 * NO_ERROR, uncertainty=parts), [])


def keyframes(poses: list[np.ndarray], origin: int, as_of: int = 2) -> KeyframePoses:
    stamps = np.arange(1, len(poses) + 1, dtype=np.int64)
    return KeyframePoses(as_of, "map", stamps, np.array(poses), None, origin)


def built(poses: list[np.ndarray], origin: int, memory: float) -> MapBuilder:
    builder = MapBuilder(VoxelMap(VoxelMapConfig(voxel_size=SIZE)), ScanStoreConfig(memory=memory))
    for stamp, pose in enumerate(poses, start=1):
        builder.fuse(scan(stamp, pose, origin))
    builder.add_keyframes(keyframes(poses, origin))
    builder.correct()
    return builder


@pytest.mark.parametrize("keeps_scans", [True, False])
def test_all_of_a_map_is_in_the_new_frame_at_once(keeps_scans: bool) -> None:
    before = [np.eye(4), perturb_transform(np.eye(4), [0.2, 0.3, 0.0, 0.0, 0.0, 0.4])]
    after = [MOVE @ pose for pose in before]
    builder = built(before, OURS, 1.0)
    if not keeps_scans:  # as after a restart: what was read from a file has no scans
        restarted = MapBuilder(builder.map, ScanStoreConfig(memory=1.0))
        restarted.add_keyframes(keyframes(before, OURS))
        builder = restarted
    with pytest.raises(FrameError):
        builder.fuse(scan(3, after[1], THEIRS))
    builder.add_keyframes(keyframes(after, THEIRS, as_of=3))
    assert not builder.is_correcting and builder.map.origin == THEIRS
    wanted = built(after, THEIRS, 1.0).map
    surface, means = builder.map.gaussians()[:2]
    assert len(surface) > 200
    distances = np.abs((means - MOVE[:3, 3]) @ MOVE[:3, :3] @ np.array([1.0, 0.0, 0.0]) - 2.0)
    assert (distances < SIZE).mean() > 0.5  # the wall that the first scan saw
    probability = wanted.probability(means)
    assert (probability > 0.5).mean() > 0.95
    builder.fuse(scan(3, after[1], THEIRS))
    with pytest.raises(FrameError):
        builder.fuse(scan(4, before[1], OURS))


def test_keyframes_of_another_map_move_nothing() -> None:
    builder = built([np.eye(4)], OURS, 1.0)
    other = replace(keyframes([MOVE], THEIRS), stamps=np.array([99], np.int64))
    with pytest.raises(FrameError):
        builder.add_keyframes(other)
    assert builder.map.origin == OURS


def test_the_places_of_a_mission_move_along() -> None:
    mission = Mission(views=1, home=KnownPlace("home", (0.5, 0.2, 0.1), {"arm": 0.3}))
    mission.home_pose = np.eye(4).tolist()
    mission.note_look(np.eye(4))
    mission.move(MOVE)
    wanted = MOVE @ np.array([0.5, 0.2, 0.0, 1.0])
    np.testing.assert_allclose(mission.home.base, [*wanted[:2], 0.1 + 0.7], atol=1e-9)
    assert mission.home.joints == {"arm": 0.3} and not mission.last_look.is_known
    np.testing.assert_allclose(mission.home_pose, MOVE, atol=1e-9)
    np.testing.assert_allclose(look_poses(mission.looks)[0], MOVE, atol=1e-6)
