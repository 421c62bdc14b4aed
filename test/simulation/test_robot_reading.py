"""What is guessed of a robot can be checked: it looks ahead, stands, and turns as it is told."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from infomap_ros.errors import RobotModelError
from infomap_ros.geometry.resources import find_share
from infomap_ros.simulation.body.drive_train import DriveTrainConfig
from infomap_ros.simulation.body.robot import read_description
from infomap_ros.simulation.body.robot_setup import RobotSetupConfig
from infomap_ros.simulation.cameras.stereo_camera import StereoCameraConfig
from infomap_ros.simulation.robots.drawing import draw_robot
from infomap_ros.simulation.robots.robot_reading import RobotReading, read_robot
from infomap_ros.simulation.robots.trial_drive import level_ground, try_drive
from infomap_ros.simulation.simulator import Simulator, SimulatorConfig

DATA = "package://example-robot-data/robots/"
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


def test_each_guess_says_which_parameter_and_why(tiago: RobotReading) -> None:
    named = {guess.partition(":")[0] for guess in tiago.guesses}
    assert named == {"robot.camera_mount", "robot.baseline", "robot.home"}
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
    with pytest.raises(RobotModelError, match="no joint moves it"):
        read_robot(place, "base_cover_link")


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
