"""A pose of the camera that odometry and joints carry on."""

from __future__ import annotations

import numpy as np
import pytest

from infomap_ros.errors import FrameError
from infomap_ros.geometry import (
    JointStateRecord,
    OdometryRecord,
    PoseRecord,
    invert_transform,
    make_transform,
)
from infomap_ros.geometry.resources import find_share
from infomap_ros.motion import RobotModel
from infomap_ros.nodes.robot.carried_pose import CarriedPose

CAMERA = "left_camera_optical_frame"
SECOND = 1_000_000_000
ROBOT = RobotModel.from_urdf(find_share("config/rover.urdf").read_text(), CAMERA, "base_link")
JOINTS = tuple(joint.name for joint in ROBOT.joints)
T_MAP_ODOM = make_transform([[0, -1, 0], [1, 0, 0], [0, 0, 1]], [3.0, -2.0, 0.5])
SIGMA = np.diag([1e-4] * 3 + [1e-5] * 3)


def joints_at(tenth: int) -> dict[str, float]:
    return dict.fromkeys(JOINTS, 0.01 * tenth)


def base_at(tenth: int) -> np.ndarray:
    return make_transform(np.eye(3), [0.05 * tenth, 0.0, 0.1])


def camera_at(tenth: int) -> np.ndarray:
    """Where the camera truly is in the map."""
    return T_MAP_ODOM @ base_at(tenth) @ ROBOT.forward_kinematics(joints_at(tenth), CAMERA)


def told(tenths: range, *, joints_until: int | None = None) -> CarriedPose:
    carried = CarriedPose(CAMERA, ROBOT)
    for tenth in tenths:
        stamp = SECOND + tenth * SECOND // 10
        odometry = OdometryRecord(stamp, "odom", base_at(tenth), None, "base_link", np.zeros(6))
        carried.add_odometry(odometry)
        if joints_until is None or tenth <= joints_until:
            positions = np.array(list(joints_at(tenth).values()))
            carried.add_joints(JointStateRecord(stamp, "", JOINTS, positions))
    return carried


def pose_at(tenth: int, covariance: np.ndarray | None = SIGMA) -> PoseRecord:
    return PoseRecord(SECOND + tenth * SECOND // 10, "map", camera_at(tenth), covariance)


def test_the_pose_goes_where_the_robot_has_gone_and_is_less_sure() -> None:
    here = told(range(20)).carry(pose_at(5))
    assert here.stamp == SECOND + 19 * SECOND // 10
    assert np.allclose(here.transform, camera_at(19), atol=1e-9)
    assert here.covariance is not None
    assert np.linalg.eigvalsh(here.covariance - SIGMA)[-1] > 0.0
    step = invert_transform(camera_at(5)) @ camera_at(19)
    assert np.trace(here.covariance[:3, :3]) > np.trace(SIGMA[:3, :3])
    assert np.linalg.norm(step[:3, 3]) > 0.5


def test_a_longer_way_makes_it_less_sure() -> None:
    near, far = (told(range(count)).carry(pose_at(5)) for count in (8, 20))
    assert near.covariance is not None and far.covariance is not None
    assert np.trace(near.covariance) < np.trace(far.covariance)


def test_it_goes_no_farther_than_odometry_and_joints_both_tell() -> None:
    here = told(range(20), joints_until=12).carry(pose_at(5))
    assert here.stamp == SECOND + 12 * SECOND // 10
    assert np.allclose(here.transform, camera_at(12), atol=1e-9)


@pytest.mark.parametrize("covariance", [SIGMA, None])
def test_a_pose_of_which_odometry_knows_nothing_stays(covariance: np.ndarray | None) -> None:
    pose = pose_at(5, covariance)
    assert told(range(0)).carry(pose) is pose
    assert told(range(6, 20)).carry(pose) is pose


def test_odometry_of_another_frame_is_refused() -> None:
    carried = told(range(3))
    record = OdometryRecord(2 * SECOND, "map", np.eye(4), None, "base_link", np.zeros(6))
    with pytest.raises(FrameError):
        carried.add_odometry(record)
