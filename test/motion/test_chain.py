"""The chain from base to camera against Pinocchio's kinematics of the whole robot."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pinocchio
import pytest

from infomap_ros.errors import InvalidInputError, RobotModelError
from infomap_ros.motion.robot.chain import KinematicChain
from infomap_ros.motion.robot.robot_model import RobotModel

from .arms import jacobian_of

REPOSITORY = Path(__file__).resolve().parents[2]

# A tree with every kind of joint, axes that are not those of the frames, joints that mimic, and
# links that branch off.
TREE = """
<robot name="tree">
  <link name="root"/><link name="side"/><link name="side_end"/><link name="column"/>
  <link name="upper"/><link name="lower"/><link name="slider"/><link name="camera"/>
  <joint name="base_turn" type="continuous">
    <parent link="root"/><child link="column"/><origin xyz="0.1 0.2 0.3" rpy="0.3 0.2 0.1"/>
    <axis xyz="0 0.6 0.8"/>
  </joint>
  <joint name="shoulder" type="revolute">
    <parent link="column"/><child link="upper"/><origin xyz="0 0 0.4" rpy="-0.5 0.1 0.7"/>
    <axis xyz="0 -1 0"/><limit lower="-1.5" upper="2.5" effort="1" velocity="0.5"/>
  </joint>
  <joint name="follower" type="revolute">
    <parent link="upper"/><child link="lower"/><origin xyz="0.3 0 0.1" rpy="0.2 0 -0.4"/>
    <axis xyz="1 1 1"/><limit lower="-3" upper="3" effort="1" velocity="1"/>
    <mimic joint="shoulder" multiplier="-0.7" offset="0.25"/>
  </joint>
  <joint name="slide" type="prismatic">
    <parent link="lower"/><child link="slider"/><origin xyz="0 0.1 0" rpy="0 1 0"/>
    <axis xyz="-1 0 0"/><limit lower="0.1" upper="0.4" effort="1" velocity="0.2"/>
  </joint>
  <joint name="mount" type="fixed">
    <parent link="slider"/><child link="camera"/><origin xyz="0 0 0.05" rpy="-1.5 0.2 0"/>
  </joint>
  <joint name="side_turn" type="revolute">
    <parent link="root"/><child link="side"/><origin xyz="-0.2 0 0.1" rpy="0 0.4 0"/>
    <axis xyz="1 0 0"/><limit lower="-1" upper="1" effort="1" velocity="0"/>
  </joint>
  <joint name="side_slide" type="prismatic">
    <parent link="side"/><child link="side_end"/><origin xyz="0 0 0.2" rpy="0 0 0.6"/>
    <axis xyz="0 0 1"/><limit lower="-0.2" upper="0.2" effort="1" velocity="0.3"/>
  </joint>
</robot>
"""


def tree(base_frame: str = "root", camera_frame: str = "camera") -> RobotModel:
    return RobotModel.from_urdf(TREE, camera_frame=camera_frame, base_frame=base_frame)


def with_arm(robot: RobotModel, joints: list[str], held: dict[str, float]) -> RobotModel:
    frames = robot.base_frame, robot.camera_frame
    return RobotModel(robot.mechanism, robot.shapes, *frames, joints, held)


def rover() -> RobotModel:
    return RobotModel.from_urdf(REPOSITORY / "config/rover.urdf", "left_camera_optical_frame")


def random_positions(chain: KinematicChain, rng: np.random.Generator, count: int) -> np.ndarray:
    low = np.where(np.isfinite(chain.lower), chain.lower, -4.0)
    high = np.where(np.isfinite(chain.upper), chain.upper, 4.0)
    return rng.uniform(low, high, size=(count, len(chain)))


def own_mimicry(xml: str) -> tuple[pinocchio.Model, pinocchio.Data]:
    """The robot with Pinocchio's own joints that mimic."""
    model = pinocchio.buildModelFromXML(xml, True)
    return model, model.createData()


def pinocchio_jacobian(xml: str, robot: RobotModel, positions: dict[str, float]) -> np.ndarray:
    """Jacobian of the camera against the root, which is the base."""
    model, data = own_mimicry(xml)
    q = pinocchio.neutral(model)
    for name, position in positions.items():
        joint = model.joints[model.getJointId(name)]
        values = [math.cos(position), math.sin(position)] if joint.nq == 2 else [position]
        q[joint.idx_q : joint.idx_q + joint.nq] = values
    aligned = pinocchio.ReferenceFrame.LOCAL_WORLD_ALIGNED
    camera = model.getFrameId(robot.camera_frame)
    jacobian = pinocchio.computeFrameJacobian(model, data, q, camera, aligned)
    columns = [model.joints[model.getJointId(name)].idx_v for name in robot.arm.joint_names]
    return np.asarray(jacobian[:, columns])


ROBOTS = {
    "tree": tree,
    "tree, camera before the base": lambda: tree("camera", "side_end"),
    "tree, from one branch to another": lambda: tree("side_end", "camera"),
    "rover": rover,
}


@pytest.mark.parametrize("robot", [make() for make in ROBOTS.values()], ids=ROBOTS)
def test_camera_pose_agrees_with_pinocchio(robot, rng):
    chain = robot.arm
    others = {joint.name: 0.0 for joint in robot.joints}
    qs = random_positions(chain, rng, 20)
    expected = [robot.forward_kinematics(others | chain.by_name(q), robot.camera_frame) for q in qs]
    np.testing.assert_allclose(chain.camera_pose(qs), expected, atol=1e-13)
    np.testing.assert_allclose(chain.camera_pose(qs[3]), expected[3], atol=1e-13)


@pytest.mark.parametrize("name", ["tree", "rover"])
def test_jacobian_agrees_with_pinocchio(name, rng):
    robot = ROBOTS[name]()
    xml = TREE if name == "tree" else (REPOSITORY / "config/rover.urdf").read_text("utf-8")
    qs = random_positions(robot.arm, rng, 20)
    expected = [pinocchio_jacobian(xml, robot, robot.arm.by_name(q)) for q in qs]
    found = [jacobian_of(robot.arm, q) for q in qs]
    np.testing.assert_allclose(found, expected, atol=1e-13)


def test_jacobian_of_a_chain_that_is_passed_backwards_by_finite_differences(rng):
    chain = tree("camera", "side_end").arm
    step = 1e-6
    for q in random_positions(chain, rng, 5):
        jacobian, pose = jacobian_of(chain, q), chain.camera_pose(q)
        for column, change in enumerate(np.eye(len(chain)) * step):
            ahead, behind = chain.camera_pose(q + change), chain.camera_pose(q - change)
            velocity = (ahead - behind) / (2.0 * step)
            spin = velocity[:3, :3] @ pose[:3, :3].T
            angular = np.array([spin[2, 1], spin[0, 2], spin[1, 0]])
            np.testing.assert_allclose(jacobian[:3, column], velocity[:3, 3], atol=1e-8)
            np.testing.assert_allclose(jacobian[3:, column], angular, atol=1e-8)


def test_joints_and_limits_are_in_the_order_from_the_base_to_the_camera():
    chain = tree().arm
    assert chain.joint_names == ("base_turn", "shoulder", "slide")
    assert chain.lower.tolist() == [-math.inf, -1.5, 0.1]
    assert chain.upper.tolist() == [math.inf, 2.5, 0.4]
    assert chain.velocity.tolist() == [math.inf, 0.5, 0.2]
    assert chain.is_continuous.tolist() == [True, False, False]
    assert chain.is_prismatic.tolist() == [False, False, True]


def test_chosen_joints_move_and_the_others_are_held(rng):
    robot = tree()
    chain = with_arm(robot, ["shoulder"], {"base_turn": 0.8}).arm
    assert chain.joint_names == ("shoulder",)
    for (shoulder,) in random_positions(chain, rng, 5):
        # The slide is held at 0.1 m, where it is nearest to zero.
        positions = {"base_turn": 0.8, "shoulder": shoulder, "slide": 0.1}
        np.testing.assert_allclose(
            chain.camera_pose([shoulder]),
            robot.forward_kinematics(positions, "camera"),
            atol=1e-13,
        )


def test_the_arm_moves_the_joints_that_the_robot_was_given():
    robot = RobotModel.from_urdf(TREE, "camera", arm_joints=("slide", "shoulder"))
    assert robot.arm.joint_names == ("shoulder", "slide")
    with pytest.raises(RobotModelError, match=r"'side_turn' does not move the camera.*shoulder"):
        RobotModel.from_urdf(TREE, "camera", arm_joints=("side_turn",))


def test_a_camera_that_is_fixed_to_the_base_has_an_empty_chain():
    robot = tree("slider", "camera")
    assert len(robot.arm) == 0
    mount = pinocchio.SE3(pinocchio.rpy.rpyToMatrix(-1.5, 0.2, 0.0), np.array([0.0, 0.0, 0.05]))
    np.testing.assert_allclose(robot.arm.camera_pose([]), mount.homogeneous, atol=1e-13)


def test_positions_by_name_and_back():
    chain = tree().arm
    positions = {"slide": 0.2, "shoulder": 1.0, "base_turn": 7.0, "side_turn": 0.1}
    assert chain.positions(positions).tolist() == [7.0, 1.0, 0.2]
    assert chain.by_name([7.0, 1.0, 0.2]) == {"base_turn": 7.0, "shoulder": 1.0, "slide": 0.2}
    with pytest.raises(RobotModelError, match="no position of joint 'shoulder', 'slide'"):
        chain.positions({"base_turn": 1.0})


@pytest.mark.parametrize("held", [{"elbow": 1.0}, {"follower": 1.0}, {"slide": math.nan}])
def test_positions_that_cannot_be_held_are_refused(held):
    with pytest.raises(RobotModelError, match=next(iter(held))):
        with_arm(tree(), ["shoulder"], held)


def test_a_robot_without_a_camera_frame_has_no_arm():
    with pytest.raises(RobotModelError, match="'tree' was given no camera frame"):
        _ = RobotModel.from_urdf(TREE).arm


@pytest.mark.parametrize("q", [[0.0, 1.0], [[0.0, 1.0]], 1.0, [0.0, math.nan, 0.2], "abc"])
def test_malformed_positions_are_refused(q):
    with pytest.raises(InvalidInputError, match="q"):
        tree().arm.camera_pose(q)


def test_impossible_limits_are_refused():
    with pytest.raises(RobotModelError, match=r"'shoulder' has the lower limit 3, upper 2\.5"):
        RobotModel.from_urdf(TREE.replace('lower="-1.5"', 'lower="3"'))
