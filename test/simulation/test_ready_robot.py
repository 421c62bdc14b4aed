"""What a simulator must know of a robot is read from its description, or asked for by name."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from xml.etree import ElementTree

import mujoco
import numpy as np
import pytest
import trimesh

from infomap_ros.errors import ConfigError, RobotModelError
from infomap_ros.geometry.resources import find_share
from infomap_ros.motion.robot.robot_model import RobotModel
from infomap_ros.simulation.body.extended_description import mend_inertias
from infomap_ros.simulation.body.robot import find_description, load_robot, read_description
from infomap_ros.simulation.body.robot_setup import RobotSetupConfig
from infomap_ros.simulation.robots.ready_robot import ready_robot

DATA = "package://example-robot-data/robots/"
TIAGO = DATA + "tiago_description/robots/tiago_no_hand.urdf"
PR2, UR5 = DATA + "pr2_description/urdf/pr2.urdf", DATA + "ur_description/urdf/ur5_robot.urdf"
MOUNT = RobotSetupConfig(camera_mount="tool0: 0 0 0.02 0 0 0", baseline=0.06)


def text_of(place: str) -> str:
    return read_description(find_description(place))


@pytest.fixture(scope="module")
def rover() -> str:
    return read_description(find_share("config/rover.urdf"))


def test_the_rover_needs_nothing_but_its_description(rover: str) -> None:
    ready = ready_robot(rover, RobotSetupConfig())
    setup = ready.setup
    assert ready.description == rover
    assert setup.base_frame == "base_link"
    assert setup.left_wheels == ("front_left_wheel_joint", "rear_left_wheel_joint")
    assert setup.left_camera_frame == "left_camera_optical_frame"
    assert setup.right_camera_frame == "right_camera_optical_frame"
    assert setup.home == (0.0, -0.35, 0.65, 0.0)  # of its <ros2_control>
    assert ready.mended == ()


def test_what_is_given_counts(rover: str) -> None:
    given = RobotSetupConfig(arm_joints=("arm_pan_joint",), home=(0.5,), baseline=0.2)
    setup = ready_robot(rover, given).setup
    assert (setup.arm_joints, setup.home) == (("arm_pan_joint",), (0.5,))
    assert (setup.right_camera_frame, setup.baseline) == ("", 0.2)


@pytest.mark.parametrize(
    ("place", "setup", "parameter"),
    [
        (UR5, RobotSetupConfig(), "robot.left_wheels"),
        (TIAGO, RobotSetupConfig(), "robot.left_camera_frame"),
        (TIAGO, RobotSetupConfig(left_camera_frame="xtion_rgb_optical_frame"), "robot.baseline"),
        (UR5, dataclasses.replace(MOUNT, cart=(0.5, 0.4, 0.3), home=(1.0,)), "robot.home"),
        (UR5, RobotSetupConfig(camera_mount="hook: 0 0 0 0 0 0"), "robot.camera_mount"),
    ],
)
def test_what_the_description_leaves_open_is_asked_for_by_name(
    place: str, setup: RobotSetupConfig, parameter: str
) -> None:
    with pytest.raises(ConfigError) as caught:
        ready_robot(text_of(place), setup)
    assert caught.value.parameter == parameter
    assert "front_left_wheel" not in str(caught.value)  # nothing of the rover


def test_an_arm_stands_on_its_cart() -> None:
    setup = dataclasses.replace(MOUNT, base_frame="cart", cart=(0.5, 0.4, 0.3))
    ready = ready_robot(text_of(UR5), setup)
    robot = RobotModel.from_urdf(ready.description, "left_camera_optical_frame", "cart")
    joints = {joint.name: joint.rest for joint in robot.joints}
    assert robot.forward_kinematics(joints, "base_link")[2, 3] == pytest.approx(0.12 + 0.3)
    mounted = robot.forward_kinematics(joints, "left_camera_optical_frame")
    tool = robot.forward_kinematics(joints, "tool0")
    np.testing.assert_allclose(mounted[:3, 3], tool[:3, 3] + 0.02 * tool[:3, 2], atol=1e-9)
    wheel = robot.forward_kinematics(joints, "cart_left_wheel")
    np.testing.assert_allclose(wheel[:3, 3], (0.0, 0.18, 0.1), atol=1e-9)
    np.testing.assert_allclose(wheel[:3, 2], (0.0, 1.0, 0.0), atol=1e-6)
    assert load_robot(ready.description).compile().body("cart").mass[0] > 10.0


def inertial(ixx: float, iyy: float, izz: float, ixy: float = 0.0) -> ElementTree.Element:
    inertia = f"ixx='{ixx}' iyy='{iyy}' izz='{izz}' ixy='{ixy}' ixz='0' iyz='0'"
    return ElementTree.fromstring(
        f"<robot name='r'><link name='a'><inertial><mass value='1'/><inertia {inertia}/>"
        "</inertial></link></robot>"
    )


@pytest.mark.parametrize(
    "moments", [(0.001, 0.001, 0.01), (-0.001, 0.02, 0.02), (0.001, 0.01, 0.01, 0.02)]
)
def test_impossible_inertias_become_possible(moments: tuple[float, ...]) -> None:
    robot = inertial(*moments)
    assert [item.link for item in mend_inertias(robot)] == ["a"]
    element = robot.find("link/inertial/inertia")
    assert element is not None
    xx, yy, zz, xy, xz, yz = (
        float(element.get(key, "nan")) for key in ("ixx", "iyy", "izz", "ixy", "ixz", "iyz")
    )
    a, b, c = np.linalg.eigvalsh([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    assert a > 0.0
    assert a + b >= c
    assert mend_inertias(robot) == []  # nothing is left to mend


def test_flat_bodies_pass_the_simulator_unsaid() -> None:
    """By rounding a + b may fall short of c: MuJoCo refused half of them."""
    rng = np.random.default_rng(0)
    for _ in range(20):
        a, b = rng.uniform(1e-7, 1e-3, 2)
        axes, _ = np.linalg.qr(rng.normal(size=(3, 3)))
        matrix = axes @ np.diag([a, b, a + b]) @ axes.T
        robot = ElementTree.fromstring(
            "<robot name='r'><link name='base'/><joint name='j' type='continuous'>"
            "<parent link='base'/><child link='a'/><axis xyz='0 0 1'/></joint>"
            "<link name='a'><inertial><mass value='1'/><inertia/></inertial></link></robot>"
        )
        element = robot.find("link/inertial/inertia")
        assert element is not None
        for row, column in zip(*np.triu_indices(3), strict=True):
            element.set(f"i{'xyz'[row]}{'xyz'[column]}", f"{matrix[row, column]:.8g}")
        assert mend_inertias(robot) == []
        mujoco.MjModel.from_xml_string(ElementTree.tostring(robot, "unicode"))


def test_possible_inertias_are_left_alone() -> None:
    robot = inertial(0.01, 0.02, 0.0299)  # nearly those of a plate, the limit of what is possible
    before = ElementTree.tostring(robot)
    assert mend_inertias(robot) == []
    assert ElementTree.tostring(robot) == before


def test_a_link_that_moves_gets_a_mass() -> None:
    robot = ElementTree.fromstring(
        "<robot name='r'><link name='a'/><link name='b'/><link name='c'/>"
        "<joint name='j' type='continuous'><parent link='a'/><child link='b'/></joint>"
        "<joint name='f' type='fixed'><parent link='b'/><child link='c'/></joint></robot>"
    )
    assert [item.link for item in mend_inertias(robot)] == ["b"]
    assert load_robot(ElementTree.tostring(robot, encoding="unicode")).compile().nbody == 4


def test_pr2_and_tiago_can_be_simulated_and_say_what_was_mended() -> None:
    for place, masses in ((PR2, 257.164), (TIAGO, 64.962)):  # as Pinocchio adds them up
        assert load_robot(text_of(place)).compile().body_mass.sum() == pytest.approx(masses, 1e-4)
    setup = RobotSetupConfig(left_camera_frame="xtion_rgb_optical_frame", baseline=0.06)
    said = " ".join(ready_robot(text_of(TIAGO), setup).mended)
    assert "torso_lift_link" in said
    assert "base_antenna_left_link" in said


def test_collada_meshes_are_those_of_another_reader() -> None:
    """Truth: trimesh, with pycollada."""
    model = load_robot(text_of(TIAGO)).compile()
    tree = ElementTree.fromstring(text_of(TIAGO))
    link = next(k for k in tree.findall("link") if k.get("name") == "arm_4_link")
    mesh = link.find("collision/geometry/mesh")
    assert mesh is not None
    expected = trimesh.load(mesh.get("filename", "").removeprefix("file://"), force="mesh")
    geom = next(
        g
        for g in range(model.ngeom)
        if model.geom_group[g] == 3 and model.body(model.geom_bodyid[g]).name == "arm_4_link"
    )
    number = int(model.geom_dataid[geom])
    first, count = int(model.mesh_vertadr[number]), int(model.mesh_vertnum[number])
    vertices = model.mesh_vert[first : first + count]  # in the frame of its middle and main axes
    found = np.sort(np.linalg.norm(vertices - vertices.mean(axis=0), axis=1))
    points = np.unique(np.round(expected.vertices, 7), axis=0)
    known = np.sort(np.linalg.norm(points - points.mean(axis=0), axis=1))
    assert len(found) == len(known)
    np.testing.assert_allclose(found, known, atol=1e-5)


def test_a_collision_mesh_that_is_nowhere_is_refused(tmp_path: Path) -> None:
    link = f"<collision><geometry><mesh filename='{tmp_path}/a.dae'/></geometry></collision>"
    with pytest.raises(RobotModelError, match=r"link 'a'.*a\.dae"):
        load_robot(f"<robot name='r'><link name='a'>{link}</link></robot>")
