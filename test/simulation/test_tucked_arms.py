"""Arms that do not carry the camera are put out of the way, by the description alone."""

from __future__ import annotations

import numpy as np
import pytest

from infomap_ros.errors import ConfigError
from infomap_ros.motion.robot.body_shapes import BodyShape
from infomap_ros.motion.robot.robot_model import RobotModel
from infomap_ros.simulation.body.robot import read_description
from infomap_ros.simulation.body.robot_setup import RobotSetupConfig
from infomap_ros.simulation.body.trial import measure_robot
from infomap_ros.simulation.robots.home_posture import tucked_arms
from infomap_ros.simulation.robots.ready_robot import ready_robot
from infomap_ros.simulation.robots.robot_file import RobotFile


def model_of(name: str) -> tuple[RobotModel, RobotSetupConfig, str]:
    file = RobotFile.read(name)
    ready = ready_robot(read_description(file.description_path), file.setup)
    setup = ready.setup
    frames = setup.left_camera_frame, setup.base_frame
    robot = RobotModel.from_urdf(ready.description, *frames, mimics=setup.leaders)
    return robot, setup, ready.description


def reach_of(robot: RobotModel, joints: dict[str, float], part: str) -> float:
    """How far vertices of links whose names begin so are from the middle, ahead or aside [m]."""

    def corners(shape: BodyShape, transform: np.ndarray) -> np.ndarray:
        points = np.zeros((1, 3)) if shape.vertices is None else shape.vertices
        return points @ transform[:3, :3].T + transform[:3, 3]

    placed = robot.solids_in(robot.base_frame, joints)
    return max(
        float(np.abs(corners(shape, solid.transform)[:, :2]).max())
        for shape, solid in zip(robot.shapes, placed, strict=True)
        if shape.link.startswith(part)
    )


@pytest.mark.parametrize(
    ("name", "part", "half"), [("pr2", "r_", 0.34), ("tiago_pro", "arm_right", 0.36)]
)
def test_the_second_arm_is_tucked_in(name: str, part: str, half: float) -> None:
    robot, setup, description = model_of(name)
    tucked = tucked_arms(robot, setup.wheels)
    assert not tucked.keys() & {*setup.arm_joints, *setup.wheels}
    rest = {joint.name: joint.rest for joint in robot.joints}
    assert reach_of(robot, rest, part) > half + 0.4
    assert reach_of(robot, rest | tucked, part) < half + 0.25
    # The file that comes with the package has such a posture, and the simulation starts in it.
    home = measure_robot(description, setup).home
    assert home.items() >= setup.held_positions.items()
    assert reach_of(robot, rest | setup.held_positions, part) < half + 0.25


def test_one_arm_is_left_to_the_camera() -> None:
    robot, setup, _ = model_of("ur5_on_base")
    assert tucked_arms(robot, setup.wheels) == {}


@pytest.mark.parametrize("entry", ["arm_joint", "arm_joint:far"])
def test_a_held_joint_has_a_position(entry: str) -> None:
    with pytest.raises(ConfigError, match="held"):
        RobotSetupConfig(held=(entry,))
