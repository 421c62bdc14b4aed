"""Robots that nobody here designed: their chains, bodies and inverse kinematics."""

from __future__ import annotations

from functools import cache

import numpy as np
import pinocchio
import pytest

from infomap_ros.errors import ConfigError
from infomap_ros.geometry import Box, Cylinder, Sphere, points_inside
from infomap_ros.motion.arm.inverse_kinematics import solve_ik_batch
from infomap_ros.motion.robot.robot_model import DescriptionConfig, RobotModel
from infomap_ros.motion.robot.urdf import read_urdf

from .arms import jacobian_of, random_positions
from .known_robots import KNOWN_ROBOTS, TELESCOPE, TIAGO_ARM, installed, stretch, tiago


@cache
def robot_of(name: str) -> RobotModel:
    return KNOWN_ROBOTS[name]()


def resting(robot: RobotModel) -> dict[str, float]:
    """All joints at zero, or at their limit nearest to it."""
    return {joint.name: min(max(0.0, joint.lower), joint.upper) for joint in robot.joints}


def placed(robot: RobotModel, q: np.ndarray, frame: str) -> np.ndarray:
    return robot.forward_kinematics(resting(robot) | robot.arm.by_name(q), frame)


@pytest.mark.parametrize("name", KNOWN_ROBOTS)
def test_the_chain_is_that_of_pinocchio(name, rng):
    robot = robot_of(name)
    chain, model = robot.arm, robot.model
    data, camera = model.createData(), model.getFrameId(robot.camera_frame)
    columns = [model.joints[model.getJointId(joint)].idx_v for joint in chain.joint_names]
    for q in random_positions(chain, rng, 10):
        expected = placed(robot, q, robot.camera_frame)
        np.testing.assert_allclose(chain.camera_pose(q), expected, atol=1e-12)
        full = robot.mechanism.configuration(
            resting(robot) | chain.by_name(q), robot.mechanism.indices
        )
        jacobian = pinocchio.computeFrameJacobian(
            model, data, full, camera, pinocchio.ReferenceFrame.LOCAL_WORLD_ALIGNED
        )
        np.testing.assert_allclose(jacobian_of(chain, q), jacobian[:, columns], atol=1e-12)


@pytest.mark.parametrize("name", KNOWN_ROBOTS)
def test_random_reachable_poses_are_reached(name, rng):
    robot = robot_of(name)
    answers, starts = (random_positions(robot.arm, rng, 300) for _ in range(2))
    targets = np.array([placed(robot, q, robot.camera_frame) for q in answers])
    batch = solve_ik_batch(robot, targets, q_start=starts)
    cameras = np.array([placed(robot, q, robot.camera_frame) for q in batch.q])
    turns = cameras[:, :3, :3].transpose(0, 2, 1) @ targets[:, :3, :3]
    angles = [np.linalg.norm(pinocchio.log3(turn)) for turn in turns]
    reached = np.linalg.norm(cameras[:, :3, 3] - targets[:, :3, 3], axis=1) <= 1e-4
    reached &= np.array(angles) <= 1e-3
    reached &= (batch.q >= robot.arm.lower).all(axis=1) & (batch.q <= robot.arm.upper).all(axis=1)
    assert reached.mean() >= 0.995
    np.testing.assert_array_equal(batch.converged, reached)


@pytest.mark.parametrize("name", KNOWN_ROBOTS)
def test_every_vertex_of_the_collision_meshes_is_in_the_body(name, rng):
    """Truth: Pinocchio places the shapes that its own parser reads."""
    robot = robot_of(name)
    positions = resting(robot) | robot.arm.by_name(random_positions(robot.arm, rng, 1)[0])
    solids = robot.solids_in(robot.base_frame, positions)
    xml, folders = description_of(name)
    geometry = pinocchio.buildGeomFromUrdfString(
        robot.model, xml, pinocchio.GeometryType.COLLISION, package_dirs=folders
    )
    data, geometry_data = robot.model.createData(), pinocchio.GeometryData(geometry)
    q = robot.mechanism.configuration(positions, robot.mechanism.indices)
    pinocchio.updateGeometryPlacements(robot.model, data, geometry, geometry_data, q)
    pinocchio.updateFramePlacements(robot.model, data)
    T_base_root = data.oMf[robot.model.getFrameId(robot.base_frame)].inverse()
    assert len(solids) == geometry.ngeoms
    for solid, item, pose in zip(solids, geometry.geometryObjects, geometry_data.oMg, strict=True):
        if isinstance(solid.solid, Box | Cylinder | Sphere):
            continue
        vertices = np.asarray(item.geometry.vertices()).reshape(-1, 3)
        points = np.array([(T_base_root * pose).act(vertex) for vertex in vertices])
        assert points_inside(points, [solid], margins=1e-6).all(), solid.name


def description_of(name: str) -> tuple[str, list[str]]:
    """URDF text and folders of meshes."""
    endings = {
        "panda": "urdf/panda.urdf",
        "ur5": "ur5_robot.urdf",
        "tiago": "robots/tiago_no_hand.urdf",
    }
    if name == "stretch":
        path = installed("hello-robot-stretch-urdf", "SE3_eoa_wrist_dw3_tool_sg3.urdf")
        return read_urdf(path).xml, [str(path.parent)]
    path = installed("example-robot-data", endings[name])
    return read_urdf(path).xml, [str(path.parents[4])]


HEAD_AND_WRIST = tuple(
    f"joint_{name}" for name in ("head_pan", "head_tilt", "wrist_pitch", "wrist_roll")
)


def test_the_telescope_of_stretch_is_one_joint(rng):
    """One motor drives its four segments; then five joints reach position and direction."""
    robot = stretch(mimics=TELESCOPE)
    names = [
        f"joint_{part}" for part in ("lift", "arm_l3", "wrist_yaw", "wrist_pitch", "wrist_roll")
    ]
    assert robot.arm.joint_names == tuple(names)
    answers, starts = (random_positions(robot.arm, rng, 100) for _ in range(2))
    free = robot_of("stretch")
    for q in answers[:5]:
        segments = dict.fromkeys(["joint_arm_l3", *TELESCOPE], q[1])
        pose = free.forward_kinematics(robot.arm.by_name(q) | segments, free.camera_frame)
        np.testing.assert_allclose(robot.arm.camera_pose(q), pose, atol=1e-12)
    targets = robot.arm.camera_pose(answers)
    batch = solve_ik_batch(robot, targets, q_start=starts, direction_only=True)
    assert batch.converged.mean() >= 0.995
    cameras = robot.arm.camera_pose(batch.q[batch.converged])
    np.testing.assert_allclose(cameras[:, :3, 3], targets[batch.converged, :3, 3], atol=1e-4)
    np.testing.assert_allclose(cameras[:, :3, 2], targets[batch.converged, :3, 2], atol=1e-3)


def test_the_body_of_stretch_needs_no_wheels():
    """Its driver reports neither the wheels nor, in a URDF without range, the fingers."""
    robot = stretch(assumed_joints=["joint_left_wheel", "joint_right_wheel"])
    positions = resting(robot)
    for name in ("left_wheel", "right_wheel", "gripper_finger_left", "gripper_finger_right"):
        del positions[f"joint_{name}"]
    solids = robot.solids_in(robot.camera_frame, positions)
    assert {solid.name for solid in solids} == set(robot.links_with_solids)
    assert all(np.isfinite(solid.transform).all() for solid in solids)


def test_the_lift_of_tiago_can_be_left_out(rng):
    robot = tiago(arm_joints=TIAGO_ARM)
    assert robot.arm.joint_names == TIAGO_ARM
    frames, held = (robot.base_frame, robot.camera_frame), {"torso_lift_joint": 0.3}
    raised = RobotModel(robot.mechanism, robot.shapes, *frames, TIAGO_ARM, held).arm
    q = random_positions(raised, rng, 1)[0]
    holding = robot.holding({"torso_lift_joint": 0.3, "arm_1_joint": 9.0, "unknown": 1.0}).arm
    np.testing.assert_array_equal(holding.camera_pose(q), raised.camera_pose(q))
    np.testing.assert_allclose(
        raised.camera_pose(q)[:3, 3] - robot.arm.camera_pose(q)[:3, 3], [0.0, 0.0, 0.3], atol=1e-12
    )


def test_what_a_description_does_not_say_comes_from_parameters():
    """As a node reads Stretch: its text, and a folder for its meshes."""
    path = installed("hello-robot-stretch-urdf", "SE3_eoa_wrist_dw3_tool_sg3.urdf")
    config = DescriptionConfig(
        mimics=tuple(f"{follower}:{leader}" for follower, leader in TELESCOPE.items()),
        assumed_joints=("joint_left_wheel", "joint_right_wheel"),
        mesh_folders=(str(path.parent),),
    )
    arm = ("joint_lift", "joint_arm_l3", "joint_wrist_yaw")
    frame = "gripper_camera_color_optical_frame"
    robot = config.read(path.read_text("utf-8"), frame, "base_link", arm)
    assert robot.arm.joint_names == arm
    assert robot.solids_in(frame, dict.fromkeys([*arm, *HEAD_AND_WRIST], 0.1))


@pytest.mark.parametrize("mimic", ["a", "a:b:c"])
def test_malformed_mimics_are_refused(mimic):
    with pytest.raises(ConfigError, match="mimics"):
        DescriptionConfig(mimics=(mimic,))
