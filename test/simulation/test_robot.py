from __future__ import annotations

import xml.etree.ElementTree as ElementTree

import mujoco
import numpy as np
import pinocchio
import pytest

from infomap_ros.errors import RobotModelError
from infomap_ros.geometry import PinholeCamera, make_transform, perturb_transform
from infomap_ros.geometry.resources import find_share
from infomap_ros.motion.robot.robot_model import RobotModel
from infomap_ros.simulation.body.robot import (
    RobotState,
    fixed_frames,
    read_description,
    stereo_baseline,
)
from infomap_ros.simulation.cameras.rendering import COLLISION_GROUP
from infomap_ros.simulation.recorder import ARM_JOINTS
from infomap_ros.simulation.worlds.builder import World

PATH = find_share("config/rover.urdf")
UPRIGHT = dict.fromkeys(ARM_JOINTS, 0.0)
ZEROS = dict.fromkeys(
    ("arm_pan_joint", "arm_shoulder_joint", "arm_elbow_joint", "arm_wrist_joint"), 0.0
)


def test_frames_agree_with_pinocchio(world: World, rng: np.random.Generator) -> None:
    robot = RobotModel.from_urdf(PATH)
    state = RobotState(world.model, world.new_data())
    for _ in range(5):
        base = perturb_transform(np.eye(4), rng.normal(0.0, 1.0, 6))
        joints = {name: float(rng.uniform(-1.5, 1.5)) for name in state.joint_names}
        state.place(base, joints)
        for frame in ("left_camera_optical_frame", "right_camera_optical_frame", "arm_forearm"):
            expected = base @ robot.forward_kinematics(joints, frame)
            np.testing.assert_allclose(state.frame(frame), expected, atol=1e-9)


def test_cameras_look_forward_when_joints_are_zero() -> None:
    pose = RobotModel.from_urdf(PATH).forward_kinematics(ZEROS, "left_camera_optical_frame")
    np.testing.assert_allclose(pose[:3, 2], (1.0, 0.0, 0.0), atol=1e-9)  # optical axis: forward
    np.testing.assert_allclose(pose[:3, 1], (0.0, 0.0, -1.0), atol=1e-9)  # image down: down


def test_right_camera_is_one_baseline_along_x_of_the_left(description: str) -> None:
    robot = RobotModel.from_urdf(PATH)
    left = robot.forward_kinematics(ZEROS, "left_camera_optical_frame")
    right = robot.forward_kinematics(ZEROS, "right_camera_optical_frame")
    relative = np.linalg.inv(left) @ right
    expected = make_transform(np.eye(3), (stereo_baseline(description), 0.0, 0.0))
    np.testing.assert_allclose(relative, expected, atol=1e-9)


def test_all_links_have_positive_inertia() -> None:
    model = pinocchio.buildModelFromUrdf(str(PATH), pinocchio.JointModelFreeFlyer())
    assert model.njoints == 10  # universe, base, 4 arm joints, 4 wheels
    for inertia in model.inertias.tolist()[1:]:
        assert inertia.mass > 0.0
        assert np.linalg.eigvalsh(inertia.inertia).min() > 0.0


def test_nothing_is_visible_outside_the_collision_solids() -> None:
    def shapes(link: ElementTree.Element, kind: str) -> list[bytes]:
        found = link.findall(kind)
        for element in found:
            for material in element.findall("material"):
                element.remove(material)
        return [b"".join(ElementTree.tostring(child).strip() for child in e) for e in found]

    for link in ElementTree.parse(PATH).getroot().findall("link"):
        assert shapes(link, "visual") == shapes(link, "collision")


def test_collision_shapes_collide_and_are_not_drawn(world: World) -> None:
    model = world.model
    first = int(model.body("rover/base_link").id)
    ours = model.geom_bodyid >= first
    hidden = model.geom_group == COLLISION_GROUP
    assert (ours & hidden).sum() == (ours & ~hidden).sum() == 15
    assert (model.geom_contype[ours & hidden] > 0).all()
    assert (model.geom_contype[ours & ~hidden] == 0).all()


def test_baseline_can_be_changed() -> None:
    assert stereo_baseline(read_description(PATH, baseline=0.25)) == pytest.approx(0.25)


def test_fixed_frames_reach_the_optical_frames(description: str) -> None:
    edges = {edge.child_frame_id: edge for edge in fixed_frames(description)}
    edge = edges["left_camera_optical_frame"]
    assert (edge.frame_id, edge.is_static) == ("left_camera_frame", True)
    points = PinholeCamera(4, 4, 1.0, 1.0, 1.5, 1.5).back_project(np.ones((4, 4)))
    assert (points @ edge.transform[:3, :3].T)[..., 0] == pytest.approx(1.0)  # ahead is +x


def test_unknown_names_are_refused(world: World) -> None:
    state = RobotState(world.model, world.new_data())
    with pytest.raises(RobotModelError, match="no_such_joint"):
        state.place(np.eye(4), {"no_such_joint": 0.0})
    with pytest.raises(RobotModelError, match="no_such_frame"):
        state.frame("no_such_frame")
    with pytest.raises(RobotModelError, match="no robot"):
        RobotState(world.model, mujoco.MjData(world.model), "other/")


def test_unreadable_descriptions_are_refused(tmp_path: pytest.TempPathFactory) -> None:
    with pytest.raises(RobotModelError, match="absent"):
        read_description(PATH.parent / "absent.urdf")
    with pytest.raises(RobotModelError, match="left_camera_frame"):
        stereo_baseline("<robot name='r'/>")
    with pytest.raises(RobotModelError, match="robot description"):
        fixed_frames("<robot")
