"""Joints that mimic another, whatever their order and kind, against angles added by hand."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from infomap_ros.errors import RobotModelError
from infomap_ros.motion.arm.inverse_kinematics import solve_ik
from infomap_ros.motion.robot.robot_model import RobotModel

from .arms import jacobian_of


def mimic(joint: str, multiplier: float | str = 1, offset: float | str = 0) -> str:
    return f'<mimic joint="{joint}" multiplier="{multiplier}" offset="{offset}"/>'


def robot_with(*joints: tuple[str, str, str, str, str], **options: object) -> RobotModel:
    """Joints (name, type, parent, child, further XML) about y, each 1 m above the one before."""
    links = sorted({link for joint in joints for link in joint[2:4]})
    parts = [f'<link name="{link}"/>' for link in links]
    for name, kind, parent, child, more in joints:
        parts.append(
            f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
            f'<origin xyz="0 0 1"/><axis xyz="0 1 0"/>'
            f'<limit lower="-1" upper="1" effort="1" velocity="1"/>{more}</joint>'
        )
    return RobotModel.from_urdf(f'<robot name="r">{"".join(parts)}</robot>', **options)


def bend(*angles: float) -> np.ndarray:
    """Place of the last link of a chain of joints about y, 1 m apart."""
    pose = np.eye(4)
    for angle in angles:
        step = np.eye(4)
        step[:3, :3] = Rotation.from_rotvec([0.0, angle, 0.0]).as_matrix()
        step[2, 3] = 1.0
        pose = pose @ step
    return pose


CHAINS = {
    "follower after its leader": (
        [("j", "revolute", "a", "b", ""), ("k", "revolute", "b", "c", mimic("j", -0.5, 0.1))],
        lambda q: bend(q, 0.1 - 0.5 * q),
    ),
    "follower before its leader": (
        [("j", "revolute", "a", "b", mimic("k", 2.0)), ("k", "revolute", "b", "c", "")],
        lambda q: bend(2.0 * q, q),
    ),
    "follower of a follower": (
        [
            ("j", "revolute", "a", "b", ""),
            ("k", "revolute", "b", "c", mimic("j", 0.5, 0.2)),
            ("l", "revolute", "c", "d", mimic("k", -2.0, 0.3)),
        ],
        lambda q: bend(q, 0.5 * q + 0.2, -q - 0.4 + 0.3),
    ),
    "leader on another branch": (
        [("j", "revolute", "a", "b", mimic("k", 0.5)), ("k", "revolute", "a", "z", "")],
        lambda q: bend(0.5 * q),
    ),
    "continuous leader of a revolute joint": (
        [("j", "continuous", "a", "b", ""), ("k", "revolute", "b", "c", mimic("j", 0.25))],
        lambda q: bend(q, 0.25 * q),
    ),
    "continuous follower": (
        [("j", "revolute", "a", "b", ""), ("k", "continuous", "b", "c", mimic("j", 3.0, 1.0))],
        lambda q: bend(q, 3.0 * q + 1.0),
    ),
    "multiplier of zero": (
        [("j", "revolute", "a", "b", ""), ("k", "revolute", "b", "c", mimic("j", 0.0, 0.7))],
        lambda q: bend(q, 0.7),
    ),
    "fixed joint with a leader": (
        [("j", "revolute", "a", "b", ""), ("k", "fixed", "b", "c", mimic("j"))],
        lambda q: bend(q, 0.0),
    ),
}


@pytest.mark.parametrize(("joints", "expected"), CHAINS.values(), ids=CHAINS)
def test_followers_follow(joints, expected):
    last = joints[0][3] if joints[-1][3] == "z" else joints[-1][3]
    robot = robot_with(*joints, camera_frame=last)
    (leader,) = robot.arm.joint_names
    assert [joint.name for joint in robot.joints] == [leader]
    for position in (-0.9, 0.0, 0.4, 1.0):
        pose = robot.forward_kinematics({leader: position}, last)
        np.testing.assert_allclose(pose, expected(position), atol=1e-12)
        np.testing.assert_allclose(robot.arm.camera_pose([position]), pose, atol=1e-12)


@pytest.mark.parametrize(("joints", "expected"), CHAINS.values(), ids=CHAINS)
def test_inverse_kinematics_moves_the_leader(joints, expected):
    last = joints[0][3] if joints[-1][3] == "z" else joints[-1][3]
    robot = robot_with(*joints, camera_frame=last)
    result = solve_ik(robot, expected(0.6))
    assert result.converged
    np.testing.assert_allclose(robot.arm.camera_pose(result.q), expected(0.6), atol=2e-3)


def test_a_continuous_leader_beyond_a_turn():
    """Half of an angle depends on how often the leader has turned."""
    joints = [("j", "continuous", "a", "b", ""), ("k", "revolute", "b", "c", mimic("j", 0.5))]
    robot = robot_with(*joints, camera_frame="c")
    pose = robot.forward_kinematics({"j": 0.2 + 2.0 * math.pi}, "c")
    np.testing.assert_allclose(pose, bend(0.2, 0.1 + math.pi), atol=1e-12)


def test_joints_may_be_said_to_mimic():
    """Three sliding segments that one motor drives are one joint with three times the travel."""
    segments = [("j", "prismatic", "a", "b", ""), ("k", "prismatic", "b", "c", "")]
    joints = [*segments, ("l", "prismatic", "c", "d", "")]
    robot = robot_with(*joints, camera_frame="d", mimics={"k": "j", "l": "k"})
    assert robot.arm.joint_names == ("j",)
    np.testing.assert_allclose(robot.arm.camera_pose([0.1])[:3, 3], [0.0, 0.3, 3.0], atol=1e-12)
    jacobian = jacobian_of(robot.arm, np.array([0.1]))
    np.testing.assert_allclose(jacobian[:, 0], [0, 3, 0, 0, 0, 0], atol=1e-12)


@pytest.mark.parametrize(
    ("second", "mimics", "message"),
    [
        (mimic("missing"), {}, "'k' mimics 'missing', which is no moving joint"),
        (mimic("f"), {}, "'k' mimics 'f', which is no moving joint"),
        (mimic("k"), {}, "joints k mimic each other in a loop"),
        ("", {"j": "k", "k": "j"}, "joints j, k mimic each other in a loop"),
        ("", {"zz": "j"}, "no moving joint 'zz'"),
        ("", {"f": "j"}, "no moving joint 'f'"),
        (mimic("j", "two"), {}, "'k' has a malformed <mimic>"),
        (mimic("j", 1, "inf"), {}, "'k' has a <mimic> that is not finite"),
    ],
)
def test_impossible_mimicry_is_refused(second, mimics, message):
    joints = [("j", "revolute", "a", "b", ""), ("k", "revolute", "b", "c", second)]
    with pytest.raises(RobotModelError, match=message):
        robot_with(*joints, ("f", "fixed", "c", "d", ""), mimics=mimics)
