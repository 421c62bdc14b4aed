"""Scans come out when all that belongs to them is known, and not before."""

from __future__ import annotations

import numpy as np
import pytest

from infomap_ros.errors import FrameError
from infomap_ros.geometry import JointStateRecord, PoseRecord, PoseUncertainty
from infomap_ros.motion.robot.robot_model import RobotModel
from infomap_ros.pipeline.robot_body import RobotBody
from infomap_ros.pipeline.scan_synchronizer import LocatedPoses, ScanSynchronizer

STEP = 100_000_000
PARTS = PoseUncertainty(1e-4 * np.eye(6), 2e-4 * np.eye(6))
ARM = """<robot name="arm"><link name="base"/><link name="optical"/><link name="hand">
<collision><geometry><sphere radius="0.1"/></geometry></collision></link>
<joint name="mount" type="fixed"><parent link="base"/><child link="optical"/></joint>
<joint name="slide" type="prismatic"><parent link="optical"/><child link="hand"/>
<axis xyz="0 0 1"/><limit lower="0" upper="3" effort="1" velocity="1"/></joint></robot>"""


def pose(stamp: int, frame: str = "map") -> PoseRecord:
    return PoseRecord(stamp, frame, np.eye(4), PARTS.covariance)


def scans_of(poses: LocatedPoses, body: RobotBody | None = None) -> ScanSynchronizer[str]:
    drops.clear()
    return ScanSynchronizer(
        poses, body or RobotBody(), on_drop=lambda reason, _: drops.append(reason)
    )


drops: list[str] = []


@pytest.mark.parametrize("parts_first", [False, True])
def test_a_scan_waits_for_the_parts_of_its_poses_covariance(parts_first: bool) -> None:
    poses = LocatedPoses("map", are_parts_published=lambda: True)
    scans = scans_of(poses)
    scans.add_cloud(STEP, "camera", "cloud")
    if parts_first:
        poses.add_uncertainty(STEP, PARTS)
        assert not scans.take()
        scans.add_pose(pose(STEP))
    else:
        scans.add_pose(pose(STEP))
        assert not scans.take()
        poses.add_uncertainty(STEP, PARTS)
    (scan,) = scans.take()
    assert scan.cloud == "cloud"
    assert scan.pose.uncertainty is PARTS


def test_parts_that_are_lost_do_not_hold_up_what_comes_later() -> None:
    poses = LocatedPoses("map", are_parts_published=lambda: True)
    scans = scans_of(poses)
    for number in (1, 2):
        scans.add_cloud(number * STEP, "camera", str(number))
        scans.add_pose(pose(number * STEP))
    poses.add_uncertainty(2 * STEP, PARTS)
    first, second = scans.take()
    assert (first.pose.uncertainty, second.pose.uncertainty) == (None, PARTS)


def test_without_a_publisher_of_parts_a_pose_is_enough() -> None:
    scans = scans_of(LocatedPoses("map"))
    scans.add_pose(pose(STEP))
    scans.add_cloud(STEP, "camera", "cloud")
    (scan,) = scans.take()
    assert np.array_equal(scan.pose.covariance, PARTS.covariance)


def test_poses_and_clouds_in_other_frames_are_refused() -> None:
    scans = scans_of(LocatedPoses("map"))
    with pytest.raises(FrameError, match="'odom'"):
        scans.add_pose(pose(STEP, "odom"))
    scans.add_cloud(STEP, "camera", "cloud")
    with pytest.raises(FrameError, match="'other'"):
        scans.add_cloud(2 * STEP, "other", "cloud")


def test_a_scan_waits_for_joints_and_comes_with_the_body() -> None:
    body = RobotBody(RobotModel.from_urdf(ARM))
    scans = scans_of(LocatedPoses("map"), body)
    scans.add_pose(pose(STEP))
    scans.add_cloud(STEP, "optical", "cloud")
    assert not scans.take()
    body.add(JointStateRecord(STEP, "", ("slide",), np.array([0.7])))
    (scan,) = scans.take()
    np.testing.assert_allclose(scan.body[0].transform[:3, 3], [0.0, 0.0, 0.7])


@pytest.mark.parametrize("required", [True, False])
def test_a_body_without_the_cameras_frame_drops_scans_or_stays_in_them(required: bool) -> None:
    body = RobotBody(RobotModel.from_urdf(ARM), required=required)
    body.add(JointStateRecord(STEP, "", ("slide",), np.array([0.7])))
    scans = scans_of(LocatedPoses("map"), body)
    scans.add_pose(pose(STEP))
    scans.add_cloud(STEP, "nowhere", "cloud")
    taken = scans.take()
    if required:
        assert (taken, drops) == ([], ["robot description"])
    else:
        assert [list(scan.body) for scan in taken] == [[]]
        assert "nowhere" in body.unknown


def test_scans_do_not_wait_for_joints_that_nobody_tells() -> None:
    body = RobotBody(RobotModel.from_urdf(ARM), are_joints_told=lambda: False)
    scans = scans_of(LocatedPoses("map"), body)
    scans.add_pose(pose(STEP))
    scans.add_cloud(STEP, "optical", "cloud")
    (scan,) = scans.take()
    assert not scan.body
    assert "joint_states" in body.unknown
