"""What is guessed of a robot can be checked: it looks ahead, stands, and turns as it is told."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from infomap_ros.cli.command_options import with_settings
from infomap_ros.cli.robot_command import robot
from infomap_ros.errors import RobotModelError
from infomap_ros.geometry.resources import find_share
from infomap_ros.motion.base.vehicle import Vehicle
from infomap_ros.simulation.body.base_motion import DriveTrainConfig
from infomap_ros.simulation.body.robot import read_description
from infomap_ros.simulation.body.robot_setup import RobotSetupConfig
from infomap_ros.simulation.cameras.stereo_camera import StereoCameraConfig
from infomap_ros.simulation.exploring.exploration_run import ExplorationOptions
from infomap_ros.simulation.robots.drawing import draw_robot
from infomap_ros.simulation.robots.robot_file import RobotFile
from infomap_ros.simulation.robots.robot_reading import RobotReading, read_robot
from infomap_ros.simulation.robots.trial_drive import level_ground, try_drive
from infomap_ros.simulation.simulator import Simulator, SimulatorConfig
from test.motion.test_fixed_camera import fixed_rover

DATA = "package://example-robot-data/robots/"
_FIX = "<joint name='m' type='fixed'><parent link='base_link'/><child link='mast'/></joint>"
CAMERA = StereoCameraConfig(width=64, height=48, supersampling=1)


@pytest.fixture(scope="module")
def tiago() -> RobotReading:
    return read_robot(DATA + "tiago_description/robots/tiago_no_hand.urdf")


@pytest.fixture(scope="module")
def ur5() -> RobotReading:
    return read_robot(DATA + "ur_description/urdf/ur5_robot.urdf")


@pytest.mark.parametrize("name", ["tiago", "ur5"])
def test_a_guessed_robot_stands_looks_ahead_and_touches_nothing(
    name: str, request: pytest.FixtureRequest
) -> None:
    file = request.getfixturevalue(name).file
    config = SimulatorConfig(robot=file.setup, camera=CAMERA)
    robot = Simulator(level_ground(), read_description(file.description_path), config)
    robot.step(2.0)
    camera = robot.true_camera_pose()
    assert camera[:3, 2] @ (np.cos(0.15), 0.0, -np.sin(0.15)) > np.cos(0.1)  # looks ahead
    assert -camera[2, 1] > np.cos(0.3)  # upright
    assert 0.5 < camera[2, 3] < 1.4
    assert robot.true_pose()[2, 2] > np.cos(0.03)  # level
    assert robot.contacts == 0


def two_wheels(clearance: float) -> str:
    """A robot on two wheels at the back, its base so far above the ground, with an arm [m]."""

    def link(name: str, size: str, place: str, mass: float, shape: str = "") -> str:
        solid = f"<origin xyz='{place}' rpy='{'1.5708 0 0' if shape else '0 0 0'}'/>"
        geometry = f"<geometry>{shape or f'<box size={size!r}/>'}</geometry>"
        inertia = "<inertia ixx='0.1' iyy='0.1' izz='0.1' ixy='0' ixz='0' iyz='0'/>"
        inertial = f"<inertial><origin xyz='{place}'/><mass value='{mass}'/>{inertia}</inertial>"
        return f"<link name='{name}'>{inertial}<collision>{solid}{geometry}</collision></link>"

    def joint(kind: str, parent: str, child: str, place: str, axis: str) -> str:
        limit = "<limit lower='-2' upper='2' effort='50' velocity='1'/>"
        ends = f"<parent link='{parent}'/><child link='{child}'/><axis xyz='{axis}'/>"
        rest = f"{ends}<origin xyz='{place}'/>{limit}</joint>"
        return f"<joint name='{child}_joint' type='{kind}'>{rest}"

    middle = clearance + 0.15
    parts = [link("base_link", "0.5 0.3 0.3", f"0.15 0 {middle}", 20.0)]
    for side, y in (("left", 0.2), ("right", -0.2)):
        tire = "<cylinder radius='0.08' length='0.04'/>"
        parts += [link(side, "", "0 0 0", 1.0, tire)]
        parts += [joint("continuous", "base_link", side, f"0 {y} 0.08", "0 1 0")]
    parent, place = "base_link", f"0.2 0 {middle + 0.2}"
    for number, axis in enumerate(("0 0 1", "0 1 0", "0 1 0", "0 1 0")):
        child = f"arm_{number}"
        parts += [link(child, "0.05 0.05 0.18", "0 0 0.09", 0.3)]
        parts += [joint("revolute", parent, child, place, axis)]
        parent, place = child, "0 0 0.2"
    return f"<robot name='two'>{''.join(parts)}</robot>"


def test_a_base_into_which_casters_are_drawn_stands_on_it(tmp_path: Path) -> None:
    (tmp_path / "two.urdf").write_text(two_wheels(0.003))
    reading = read_robot(str(tmp_path / "two.urdf"))
    assert reading.stands
    assert reading.file.setup.casters == ("base_link",)
    assert not reading.file.setup.hovering
    assert reading.file.footprint == (-0.1, -0.22, 0.4, -0.22, 0.4, 0.22, -0.1, 0.22)
    assert reading.file.max_step == pytest.approx(0.06)
    (tmp_path / "two.yaml").write_text(reading.file.text("two"))
    read = RobotFile.read(tmp_path / "two.yaml")
    assert (read.footprint, read.max_step) == (reading.file.footprint, reading.file.max_step)
    options = with_settings(ExplorationOptions(), read.settings)
    vehicle = Vehicle.from_robot(reading.robot, options.planner.reaching.vehicle)
    assert len(vehicle.undercarriage.names) == 4


def test_a_robot_that_tips_over_is_a_failure(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "two.urdf").write_text(two_wheels(0.1))
    with pytest.raises(RobotModelError, match=r"tips over .*two\.png"):
        robot(str(tmp_path / "two.urdf"), tmp_path / "two.yaml")
    assert (tmp_path / "two.png").exists()


def test_each_guess_says_which_parameter_and_why(tiago: RobotReading) -> None:
    named = {guess.partition(":")[0] for guess in tiago.guesses}
    assert named == {"robot.camera_mount", "robot.baseline", "robot.home", "controllers"}
    assert named <= set(tiago.file.parameters)
    assert any("xtion_rgb_optical_frame" in guess for guess in tiago.guesses)
    assert any("base_antenna_left_link" in warning for warning in tiago.warnings)
    text = tiago.file.text("tiago")
    assert text.count("GUESSED") == len(named)
    assert len(text.splitlines()) <= 15


def test_an_arm_gets_a_cart(ur5: RobotReading) -> None:
    assert ur5.file.setup.cart
    assert ur5.file.parameters["base_frame"] == "cart"
    assert "robot.left_wheels" not in ur5.file.parameters  # they are the cart's


def test_another_camera_can_be_asked_for() -> None:
    place = DATA + "tiago_description/robots/tiago_no_hand.urdf"
    head = read_robot(place, "xtion_rgb_optical_frame")
    assert head.file.setup.arm_joints == ("torso_lift_joint", "head_1_joint", "head_2_joint")
    with pytest.raises(RobotModelError, match=r"--camera eye.*xtion_rgb_optical_frame"):
        read_robot(place, "eye")
    cover = read_robot(place, "base_cover_link")
    assert cover.file.setup.camera_mount.startswith("base_cover_link:")
    assert cover.file.setup.arm_joints == ()


def test_a_camera_fixed_on_the_base_needs_no_arm(tmp_path: Path) -> None:
    (tmp_path / "fixed.urdf").write_text(fixed_rover())
    reading = read_robot(str(tmp_path / "fixed.urdf"))
    assert reading.file.setup.left_camera_frame == "left_camera_optical_frame"
    assert reading.file.setup.right_camera_frame == "right_camera_optical_frame"
    assert reading.stands and reading.robot.arm.joint_names == ()
    assert reading.guesses == reading.warnings == ()
    assert any("fixed on the base" in line for line in reading.understood)


def test_without_camera_and_arm_a_link_is_asked_for(tmp_path: Path) -> None:
    bare = fixed_rover().replace("optical", "lens").replace("camera", "eye")
    (tmp_path / "bare.urdf").write_text(bare)
    with pytest.raises(RobotModelError, match=r"no link with 'optical'.*--camera LINK"):
        read_robot(str(tmp_path / "bare.urdf"))
    reading = read_robot(str(tmp_path / "bare.urdf"), "left_eye_frame")
    assert reading.file.setup.camera_mount.startswith("left_eye_frame: 0.02 0 0")
    assert reading.robot.arm.camera_pose([])[0, 2] == pytest.approx(1.0)  # looks ahead


def test_a_link_that_is_called_camera_gets_one(tmp_path: Path) -> None:
    """Descriptions for Gazebo often end at a camera_link that looks along x, without REP 103."""
    (tmp_path / "bare.urdf").write_text(fixed_rover().replace("optical", "lens"))
    reading = read_robot(str(tmp_path / "bare.urdf"))
    assert "robot.camera_mount" in reading.file.reasons
    assert reading.robot.arm.camera_pose([])[0, 2] == pytest.approx(1.0)  # looks ahead


def test_missing_meshes_are_refused_at_once_with_what_to_do(tmp_path: Path) -> None:
    mesh = "<mesh filename='package://rover_description/meshes/mast.stl'/>"
    solid = f"<collision><geometry>{mesh}</geometry></collision>"
    text = fixed_rover().replace("</robot>", f"<link name='mast'>{solid}</link>{_FIX}</robot>")
    (tmp_path / "rover.urdf").write_text(text)
    with pytest.raises(RobotModelError, match=r"mast\.stl.*rover_description must be in ROS_P"):
        read_robot(str(tmp_path / "rover.urdf"))


def test_the_gain_that_fits_is_the_ratio_of_wheels_and_base() -> None:
    """Two wheels on either side do not skid: 1. Four do, by what a long turn shows."""
    rover = read_description(find_share("config/rover.urdf"))
    trial = try_drive(rover, RobotSetupConfig())
    config = SimulatorConfig(camera=CAMERA)
    robot = Simulator(level_ground(), rover, config)
    start, turned = robot.joint_state(), 0.0
    for _ in range(40):
        before = robot.true_pose()
        robot.command_velocity(0.0, 0.5)
        robot.step(0.2)
        change = np.linalg.inv(before) @ robot.true_pose()
        turned += float(np.arctan2(change[1, 0], change[0, 0]))
    names, end = list(start.names), robot.joint_state()
    wheel = names.index("front_right_wheel_joint")
    rolled = float(end.positions[wheel] - start.positions[wheel]) * 0.0762
    assert trial.turns
    assert trial.fitting_gain == pytest.approx(rolled / 0.1591 / turned, rel=0.1)
    stretch = read_robot(
        "package://stretch_urdf/SE3/stretch_description_SE3_eoa_wrist_dw3_tool_sg3.urdf"
    )
    text = read_description(stretch.file.description_path)
    assert try_drive(text, stretch.file.setup).fitting_gain == pytest.approx(1.0, abs=0.1)


@pytest.mark.parametrize(("gain", "does"), [(1.0, "creeps"), (5.0, "swings"), (2.9, "")])
def test_a_wrong_gain_is_named(gain: float, does: str) -> None:
    rover = read_description(find_share("config/rover.urdf"))
    drive = DriveTrainConfig(turn_gain=gain)
    robot = Simulator(level_ground(), rover, SimulatorConfig(camera=CAMERA, drive=drive))
    assert robot.advice == ""
    for _ in range(20):
        robot.command_velocity(0.0, 0.5)
        robot.step(0.2)
    assert (does in robot.advice) and bool(robot.advice) == bool(does)
    if does:
        assert f"drive.turn_gain is {gain:.2g}" in robot.advice


def test_the_drawing_is_a_picture(ur5: RobotReading, tmp_path: Path) -> None:
    draw_robot(ur5, tmp_path / "ur5.png")
    picture = cv2.imread(str(tmp_path / "ur5.png"))
    assert picture.shape[0] > 1000
    assert picture.std() > 20.0


@pytest.mark.parametrize(
    ("joints", "told"),
    [
        ((("lidar", "base"), ("base", "wheel")), "'lidar' is none"),
        ((("wheel", "base"), ("base", "wheel")), "joints form a loop"),
    ],
)
def test_why_no_link_is_the_root(
    tmp_path: Path, joints: tuple[tuple[str, str], ...], told: str
) -> None:
    lines = "".join(
        f'<joint name="j{i}" type="fixed"><parent link="{a}"/><child link="{b}"/></joint>'
        for i, (a, b) in enumerate(joints)
    )
    path = tmp_path / "r.urdf"
    path.write_text(f'<robot name="r"><link name="base"/><link name="wheel"/>{lines}</robot>')
    with pytest.raises(RobotModelError, match=f"no link is the root: {told}"):
        read_robot(str(path))
