"""A pose of the camera that odometry and joints carry on."""

from __future__ import annotations

import numpy as np
import pytest

from infomap_ros.errors import FrameError, PoseUnavailableError
from infomap_ros.geometry import (
    JointStateRecord,
    OdometryRecord,
    PoseRecord,
    invert_transform,
    make_transform,
)
from infomap_ros.geometry.assumed_pose import AssumedPoseConfig
from infomap_ros.geometry.joint_buffer import JointBuffer, JointBufferConfig
from infomap_ros.geometry.resources import find_share
from infomap_ros.localization.filter.motion_prior import RobotPosture
from infomap_ros.motion.robot.robot_model import RobotModel
from infomap_ros.pipeline.tracked_robot import CarriedPose, LastPose

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


def stamp_of(tenth: int) -> int:
    return SECOND + tenth * SECOND // 10


def odometry_at(tenth: int) -> OdometryRecord:
    stamp = stamp_of(tenth)
    return OdometryRecord(stamp, "odom", base_at(tenth), None, "base_link", np.zeros(6))


def joint_state_at(tenth: int) -> JointStateRecord:
    positions = np.array(list(joints_at(tenth).values()))
    return JointStateRecord(stamp_of(tenth), "", JOINTS, positions)


def told(tenths: range, *, joints_until: int | None = None) -> CarriedPose:
    carried = CarriedPose(CAMERA, ROBOT)
    for tenth in tenths:
        carried.add_odometry(odometry_at(tenth))
        if joints_until is None or tenth <= joints_until:
            carried.add_joints(joint_state_at(tenth))
    return carried


def posture_at(tenth: int) -> RobotPosture:
    return RobotPosture(base_at(tenth), ROBOT.forward_kinematics(joints_at(tenth), CAMERA))


def pose_at(tenth: int, covariance: np.ndarray | None = SIGMA) -> PoseRecord:
    return PoseRecord(stamp_of(tenth), "map", camera_at(tenth), covariance)


class Told:
    """A last pose whose buffer of joints holds two seconds, told ten times a second."""

    def __init__(self) -> None:
        self.joints = JointBuffer(JointBufferConfig(capacity=20))
        self.last = LastPose(self.joints, AssumedPoseConfig())
        self.carried = CarriedPose(CAMERA, ROBOT)

    def run(self, tenths: range, *, odometry: bool = True) -> None:
        for tenth in tenths:
            if odometry:
                self.carried.add_odometry(odometry_at(tenth))
            self.carried.add_joints(joint_state_at(tenth))
            self.joints.add(joint_state_at(tenth))
            self.last.settle(self.carried)


def test_the_pose_goes_where_the_robot_has_gone_and_is_less_sure() -> None:
    here = told(range(20)).carry(pose_at(5), posture_at(5))
    assert here.stamp == SECOND + 19 * SECOND // 10
    assert np.allclose(here.transform, camera_at(19), atol=1e-9)
    assert here.covariance is not None
    assert np.linalg.eigvalsh(here.covariance - SIGMA)[-1] > 0.0
    step = invert_transform(camera_at(5)) @ camera_at(19)
    assert np.trace(here.covariance[:3, :3]) > np.trace(SIGMA[:3, :3])
    assert np.linalg.norm(step[:3, 3]) > 0.5


def test_a_longer_path_makes_it_less_sure() -> None:
    near, far = (told(range(count)).carry(pose_at(5), posture_at(5)) for count in (8, 20))
    assert near.covariance is not None and far.covariance is not None
    assert np.trace(near.covariance) < np.trace(far.covariance)


def test_it_goes_no_farther_than_odometry_and_joints_both_tell() -> None:
    here = told(range(20), joints_until=12).carry(pose_at(5), posture_at(5))
    assert here.stamp == SECOND + 12 * SECOND // 10
    assert np.allclose(here.transform, camera_at(12), atol=1e-9)


@pytest.mark.parametrize("covariance", [SIGMA, None])
def test_a_pose_of_which_odometry_knows_nothing_stays(covariance: np.ndarray | None) -> None:
    pose = pose_at(5, covariance)
    assert told(range(0)).carry(pose, posture_at(5)) is pose
    assert told(range(5)).carry(pose, posture_at(5)) is pose


def test_odometry_of_another_frame_is_refused() -> None:
    carried = told(range(3))
    record = OdometryRecord(2 * SECOND, "map", np.eye(4), None, "base_link", np.zeros(6))
    with pytest.raises(FrameError):
        carried.add_odometry(record)


def test_a_camera_lost_for_longer_than_joints_are_kept_is_still_carried_on() -> None:
    robot = Told()
    robot.run(range(6))
    robot.last.add(pose_at(5))
    robot.run(range(6, 3000))
    pose, joints = robot.last.now(robot.carried)
    assert pose.stamp == stamp_of(2999)
    assert np.allclose(pose.transform, camera_at(2999), atol=1e-9)
    assert joints == pytest.approx(joints_at(2999))


def test_without_odometry_the_last_pose_stays_with_the_joints_it_had() -> None:
    robot = Told()
    robot.run(range(6), odometry=False)
    robot.last.add(pose_at(5))
    robot.run(range(6, 100), odometry=False)
    pose, joints = robot.last.now(robot.carried)
    assert pose.stamp == stamp_of(5)
    assert joints == pytest.approx(joints_at(5))


def test_a_pose_that_comes_before_its_joints_waits_for_them() -> None:
    robot = Told()
    with pytest.raises(PoseUnavailableError, match="no camera_pose"):
        robot.last.now(robot.carried)
    robot.run(range(5))
    robot.last.add(pose_at(8))
    with pytest.raises(PoseUnavailableError, match="after the last joint state"):
        robot.last.now(robot.carried)
    robot.run(range(5, 12))
    assert np.allclose(robot.last.now(robot.carried)[0].transform, camera_at(11), atol=1e-9)


def test_a_later_pose_whose_joints_are_missing_leaves_the_one_before() -> None:
    robot = Told()
    robot.run(range(10))
    robot.last.add(pose_at(5))
    robot.last.settle(robot.carried)
    robot.last.add(pose_at(30))
    assert robot.last.newest_stamp == stamp_of(30)
    assert np.allclose(robot.last.now(robot.carried)[0].transform, camera_at(9), atol=1e-9)


def test_a_clock_that_was_set_back_begins_anew() -> None:
    robot = Told()
    robot.run(range(100))
    robot.last.add(pose_at(90))
    robot.last.settle(robot.carried)
    robot.last.add(pose_at(3))
    with pytest.raises(PoseUnavailableError):
        robot.last.now(robot.carried)
    robot.run(range(6))
    assert np.allclose(robot.last.now(robot.carried)[0].transform, camera_at(5), atol=1e-9)
