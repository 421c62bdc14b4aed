"""Hello Robot Stretch, which nobody here designed: two wheels, a caster, a lift, a telescope."""

from __future__ import annotations

import importlib.metadata
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
import trimesh

from infomap_ros.errors import ConfigError, RobotModelError
from infomap_ros.motion.robot.robot_model import RobotModel
from infomap_ros.simulation.body.base_motion import DriveTrainConfig, planar
from infomap_ros.simulation.body.robot import load_robot, read_description
from infomap_ros.simulation.body.robot_setup import RobotSetupConfig
from infomap_ros.simulation.cameras.stereo_camera import StereoCameraConfig
from infomap_ros.simulation.robots.robot_file import RobotFile
from infomap_ros.simulation.simulator import Simulator, SimulatorConfig
from infomap_ros.simulation.worlds.builder import SceneBuilder, World
from infomap_ros.simulation.worlds.terrain import Terrain

URDF = "stretch_urdf/SE3/stretch_description_SE3_eoa_wrist_dw3_tool_sg3.urdf"
FILE = RobotFile.read("stretch")
TELESCOPE = [f"joint_arm_l{number}" for number in range(4)]


def config() -> SimulatorConfig:
    """The configuration of config/robots/stretch.yaml, with small images."""
    camera = StereoCameraConfig(width=64, height=48, supersampling=1)
    drive = DriveTrainConfig(turn_gain=FILE.turn_gain)
    return SimulatorConfig(robot=FILE.setup, drive=drive, camera=camera)


def floor() -> World:
    builder = SceneBuilder(Terrain(np.zeros((9, 9)), 4.0))
    builder.add_ground_material("ground", np.full((64, 64, 3), 128, np.uint8), 1.0)
    builder.add_terrain("ground")
    return builder.compile()


@pytest.fixture(scope="module")
def path() -> Path:
    files = importlib.metadata.files("hello-robot-stretch-urdf") or []
    return next(Path(str(f.locate())).resolve() for f in files if str(f).endswith(URDF))


@pytest.fixture(scope="module")
def stretch(path: Path) -> Simulator:
    return Simulator(floor(), read_description(path), config())


def finish(simulator: Simulator) -> None:
    start = simulator.time
    while simulator.is_moving:
        simulator.step(0.1)
        assert simulator.time - start < 60.0


def test_it_stands_drives_and_touches_nothing(stretch: Simulator) -> None:
    finish(stretch)
    assert stretch.true_pose()[2, 2] > 0.9999
    stretch.follow_base_path([(0, 0, 0), (0.5, 0, 0), (0.5, 0, 1.2)])
    finish(stretch)
    truth = planar(np.linalg.inv(stretch.T_world_odom) @ stretch.true_pose())
    np.testing.assert_allclose(truth, (0.5, 0.0, 1.2), atol=0.06)
    assert (stretch.problem, stretch.contacts) == ("", 0)


def test_the_segments_of_the_telescope_move_together(stretch: Simulator) -> None:
    stretch.follow_arm_trajectory(["joint_lift", "joint_arm_l3"], [(0.8, 0.1)], [1.0])
    finish(stretch)
    joints = stretch.joint_state()
    positions = dict(zip(joints.names, joints.positions, strict=True))
    np.testing.assert_allclose([positions[name] for name in TELESCOPE], 0.1, atol=0.01)
    assert positions["joint_lift"] == pytest.approx(0.8, abs=0.01)
    with pytest.raises(RobotModelError, match="joint_arm_l1"):
        stretch.follow_arm_trajectory(["joint_arm_l1"], [(0.0,)], [1.0])


def test_the_camera_is_where_its_kinematics_say(stretch: Simulator) -> None:
    finish(stretch)
    robot = RobotModel.from_urdf(stretch.description, FILE.setup.left_camera_frame, "base_link")
    joints = stretch.joint_state()
    positions = dict(zip(joints.names, joints.positions.tolist(), strict=True))
    expected = stretch.true_pose() @ robot.forward_kinematics(positions, robot.camera_frame)
    np.testing.assert_allclose(stretch.true_camera_pose(), expected, atol=0.01)
    right = stretch.calibrations[1].projection
    assert -right[0, 3] / right[0, 0] == pytest.approx(FILE.setup.baseline)


def test_it_sees_the_floor(stretch: Simulator) -> None:
    pair = stretch.capture()
    assert pair.left.std() > 1.0
    stretch.close()


def test_descriptions_name_their_meshes_from_anywhere(path: Path) -> None:
    tree = ElementTree.fromstring(read_description(path))
    names = {mesh.get("filename", "") for mesh in tree.iter("mesh")}
    assert names
    assert all(Path(name.removeprefix("file://")).is_file() for name in names)


def test_meshes_of_packages_elsewhere_are_found(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What xacro writes into a folder of its own names meshes of packages in ROS_PACKAGE_PATH."""
    mesh = tmp_path / "packages" / "arm_description" / "a.stl"
    mesh.parent.mkdir(parents=True)
    trimesh.creation.box((0.2, 0.1, 0.1)).export(mesh)
    geometry = "<geometry><mesh filename='package://arm_description/a.stl'/></geometry>"
    link = f"<link name='a'><visual>{geometry}</visual><collision>{geometry}</collision></link>"
    urdf = tmp_path / "elsewhere" / "arm.urdf"
    urdf.parent.mkdir()
    urdf.write_text(f"<robot name='r'>{link}</robot>")
    monkeypatch.setenv("ROS_PACKAGE_PATH", str(tmp_path / "packages"))
    tree = ElementTree.fromstring(read_description(urdf))
    names = [mesh.get("filename", "") for mesh in tree.iter("mesh")]
    assert names == [f"file://{mesh}"] * 2


def test_what_is_only_seen_may_be_missing() -> None:
    """A robot whose visual meshes were left behind drives all the same; they are not drawn."""
    seen = (
        "<visual><geometry><mesh filename='package://arm_description/a.stl'/></geometry></visual>"
    )
    solid = "<collision><geometry><box size='0.1 0.1 0.1'/></geometry></collision>"
    inertia = "<inertia ixx='0.1' iyy='0.1' izz='0.1' ixy='0' ixz='0' iyz='0'/>"
    inertial = f"<inertial><mass value='1'/>{inertia}</inertial>"
    load_robot(f"<robot name='r'><link name='a'>{inertial}{seen}{solid}</link></robot>")


def test_a_collision_mesh_of_an_unknown_kind_is_refused() -> None:
    link = "<collision><geometry><mesh filename='a.dae'/></geometry></collision>"
    with pytest.raises(RobotModelError, match=r"link 'a'.*a\.dae"):
        load_robot(f"<robot name='r'><link name='a'>{link}</link></robot>")


def test_impossible_setups_are_refused() -> None:
    with pytest.raises(ConfigError, match="home"):
        RobotSetupConfig(home=(0.0,), arm_joints=("a", "b"))
    with pytest.raises(ConfigError, match="cart"):
        RobotSetupConfig(cart=(0.5, 0.4))
    with pytest.raises(ConfigError, match="camera_mount"):
        RobotSetupConfig(camera_mount="tool0 0 0 0")
    with pytest.raises(ConfigError, match="mimics"):
        RobotSetupConfig(mimics=("joint_a",))
