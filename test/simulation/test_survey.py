from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from infomap_ros.geometry import transform_points
from infomap_ros.geometry.resources import find_share
from infomap_ros.motion.robot.robot_model import RobotModel
from infomap_ros.simulation.body.robot import RobotState
from infomap_ros.simulation.recorder import ARM_JOINTS, Chassis, RecorderConfig, Survey
from infomap_ros.simulation.worlds.builder import World
from infomap_ros.simulation.worlds.terrain import Terrain


@pytest.fixture
def chassis(world: World) -> Chassis:
    data = world.new_data()
    return Chassis(world.model, data, RobotState(world.model, data))


def _slope(angle: float) -> Terrain:
    axis = np.linspace(-3.0, 3.0, 61)
    return Terrain(np.tile(np.tan(angle) * axis, (61, 1)), 3.0)


@pytest.mark.parametrize("heading", [0.0, 0.7, -2.5])
def test_on_a_slope_all_wheels_touch_and_the_body_follows(chassis: Chassis, heading: float) -> None:
    angle = 0.15
    pose = chassis.rest(_slope(angle), 0.3, -0.2, heading)
    normal = np.array((-np.sin(angle), 0.0, np.cos(angle)))
    np.testing.assert_allclose(pose[:3, 2], normal, atol=1e-3)
    axles = transform_points(pose, chassis._axles)
    np.testing.assert_allclose(axles @ normal, chassis.wheel_radius, atol=2e-3)
    assert np.arctan2(pose[1, 0], pose[0, 0]) == pytest.approx(heading, abs=0.02)


def test_wheels_roll_the_way_they_go(chassis: Chassis) -> None:
    before, after = np.eye(4), np.eye(4)
    after[0, 3] = 0.1
    for turn in chassis.wheel_turn(before, after).values():
        assert turn == pytest.approx(0.1 / chassis.wheel_radius)
    after = np.eye(4)
    after[:3, :3] = Rotation.from_euler("z", 0.01).as_matrix()
    turns = chassis.wheel_turn(before, after)
    assert turns["front_left_wheel_joint"] < 0.0 < turns["front_right_wheel_joint"]


def test_script_respects_the_limits_of_the_joints() -> None:
    robot = RobotModel.from_urdf(find_share("config/rover.urdf"))
    survey = Survey(RecorderConfig().duration)
    times = np.linspace(0.0, survey.duration, 400)
    angles = np.array([[survey.at(t).joints[name] for name in ARM_JOINTS] for t in times])
    rates = np.abs(np.diff(angles, axis=0)).max(axis=0) / (times[1] - times[0])
    for column, name in enumerate(ARM_JOINTS):
        limits = robot.joint(name)
        assert limits.lower < angles[:, column].min()
        assert angles[:, column].max() < limits.upper
        assert rates[column] < 1.0


def test_base_drives_forward_along_its_heading() -> None:
    survey = Survey(10.0)
    for time in np.linspace(0.05, 9.9, 60):
        now, soon = survey.at(time), survey.at(time + 0.01)
        motion = np.array((soon.x - now.x, soon.y - now.y))
        assert motion @ (np.cos(now.heading), np.sin(now.heading)) == pytest.approx(
            np.linalg.norm(motion), rel=1e-3
        )


def test_time_outside_the_script_holds_its_ends() -> None:
    survey = Survey(10.0)
    assert survey.at(-1.0) == survey.at(0.0)
    assert survey.at(11.0) == survey.at(10.0)
