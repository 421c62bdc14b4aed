"""A camera that no joint moves: the base brings it to views, as an arm without joints."""

from __future__ import annotations

import numpy as np
import pytest

from infomap_ros.geometry.resources import find_share
from infomap_ros.motion.reaching import WholeBodyReach
from infomap_ros.motion.robot.robot_model import RobotModel
from infomap_ros.motion.robot.solid_extent import camera_elevations, camera_heights

from .scenes import map_where
from .test_reaching import (
    BASE,
    assert_reaches,
    closed_wall,
    everything,
    looking,
    wall_with_a_gate,
)

CAMERA = "left_camera_optical_frame"
HEIGHT = 0.8972  # of the camera above the ground, the arm upright [m]


def fixed_rover() -> str:
    """The rover's description with its arm welded upright."""
    text = find_share("config/rover.urdf").read_text("utf-8")
    return text.replace('type="revolute"', 'type="fixed"')


@pytest.fixture(scope="module")
def robot() -> RobotModel:
    return RobotModel.from_urdf(fixed_rover(), camera_frame=CAMERA)


@pytest.fixture(scope="module")
def gate(robot: RobotModel) -> WholeBodyReach:
    return WholeBodyReach(robot, map_where(wall_with_a_gate, everything), BASE, {})


def test_an_arm_without_joints_holds_its_camera_in_one_place(robot: RobotModel) -> None:
    assert robot.arm.joint_names == ()
    pose = robot.arm.camera_pose([])
    np.testing.assert_allclose(pose, robot.forward_kinematics({}, CAMERA), atol=1e-12)
    assert camera_heights(robot) == pytest.approx((HEIGHT, HEIGHT))
    assert camera_elevations(robot) == pytest.approx((0.0, 0.0))


def test_a_camera_below_the_least_height_of_an_arm_is_where_it_is() -> None:
    text = fixed_rover().replace('xyz="0 0 0.2286"', 'xyz="0 0 -0.45"')
    low, high = camera_heights(RobotModel.from_urdf(text, camera_frame=CAMERA))
    assert low == high


@pytest.mark.parametrize(
    "view",
    [
        looking((2.2, 0.3, HEIGHT), 2.0),
        looking((-2.0, 1.0, HEIGHT), -1.0),
        looking((-1.5, -1.8, HEIGHT - 0.02), 3.0, -0.05),
    ],
)
def test_the_base_brings_it_to_views_at_its_height(gate: WholeBodyReach, view: np.ndarray) -> None:
    assert gate.may_reach(view) == [""]
    result = gate.reach(view)
    assert_reaches(gate, result, view)
    assert result.route is not None and result.route.moves_base
    assert result.joint_travel == 0.0


def test_where_it_is_nothing_moves(gate: WholeBodyReach) -> None:
    result = gate.reach(BASE @ gate._whole.chain.camera_pose([]))
    assert result.reason == "" and result.route is not None
    assert not result.route.moves_base and not result.route.arm_after.moves


@pytest.mark.parametrize(
    "view", [looking((2.2, 0.3, HEIGHT + 0.3), 2.0), looking((2.2, 0.3, HEIGHT), 2.0, -0.5)]
)
def test_higher_or_steeper_views_are_out_of_reach(gate: WholeBodyReach, view: np.ndarray) -> None:
    assert gate.may_reach(view) != [""]
    assert gate.reach(view).reason != ""


def test_the_path_ends_before_a_wall(robot: RobotModel) -> None:
    reach = WholeBodyReach(robot, map_where(closed_wall, everything), BASE, {})
    assert reach.reach(looking((2.2, 0.3, HEIGHT), 2.0)).reason != ""


def test_a_camera_on_the_axis_of_the_base_reaches_views() -> None:
    """A radius of 0 stands for heights to which no posture brings the camera."""
    added = (
        '<link name="middle"/><joint name="middle_joint" type="fixed"><parent link="base_link"/>'
        f'<child link="middle"/><origin xyz="0 0 {HEIGHT - 0.0762}" '
        'rpy="-1.570796327 0 -1.570796327"/></joint></robot>'
    )
    robot = RobotModel.from_urdf(fixed_rover().replace("</robot>", added), camera_frame="middle")
    reach = WholeBodyReach(robot, map_where(wall_with_a_gate, everything), BASE, {})
    assert reach.may_reach(looking((2.2, 0.3, HEIGHT), 2.0)) == [""]
