"""Other robots in the way: neither base nor arm goes where they stand; paths lead around them."""

from __future__ import annotations

import numpy as np
import pytest

from infomap_ros.errors import InvalidInputError
from infomap_ros.motion.keep_out import Obstacle, with_obstacles
from infomap_ros.motion.reaching import WholeBodyReach
from infomap_ros.motion.robot.robot_model import RobotModel

from .bodies import rover
from .grounds import ground as terrain_where
from .scenes import map_where
from .test_reaching import BASE, assert_reaches, everything, ground, looking

AHEAD = Obstacle(1.2, 0.0, 0.5, 0.0, 0.9, "robot 2")


@pytest.fixture(scope="module")
def robot() -> RobotModel:
    return rover()


def reach_among(robot: RobotModel, *obstacles: Obstacle) -> WholeBodyReach:
    joints = {joint.name: 0.0 for joint in robot.joints}
    return WholeBodyReach(robot, map_where(ground, everything), BASE, joints, obstacles=obstacles)


def driving_body(reach: WholeBodyReach, pose: np.ndarray) -> np.ndarray:
    """Centers and radii of the robot's collision spheres in its driving posture, (S, 4) [m]."""
    return reach._whole.body.spheres(reach._whole.driving, pose)


def test_the_base_drives_around_another_robot(robot: RobotModel) -> None:
    view = looking((2.4, 0.2, 0.5), 0.0)
    straight = reach_among(robot).reach(view)
    assert straight.route is not None
    through = np.hypot(straight.route.base_path[:, 0] - 1.2, straight.route.base_path[:, 1])
    assert through.min() < 0.5, "without it the path leads through its place"

    reach = reach_among(robot, AHEAD)
    result = reach.reach(view)
    assert_reaches(reach, result, view)
    assert result.route is not None and result.travel > straight.travel
    for pose in result.route.base_poses:
        spheres = driving_body(reach, pose)
        away = np.hypot(spheres[:, 0] - AHEAD.x, spheres[:, 1] - AHEAD.y) - spheres[:, 3]
        assert away[spheres[:, 2] < AHEAD.top].min() > AHEAD.radius


def test_the_arm_does_not_reach_into_another_robot(robot: RobotModel) -> None:
    chain = reach_among(robot)._whole.chain
    view = BASE @ chain.camera_pose([0.0, 0.5, 0.4, -0.3])
    assert reach_among(robot).reach(view).reason == ""
    place = view[:3, 3]
    there = Obstacle(float(place[0]), float(place[1]), 0.12, 0.0, float(place[2]) + 0.1)
    reach = reach_among(robot, there)
    alone, why_not = reach._routes.arm_to_view(view, reach._ik)
    assert alone is None and "touches" in why_not


def test_a_robot_beside_another_may_leave_it(robot: RobotModel) -> None:
    beside = Obstacle(-0.62, 0.0, 0.3, 0.0, 0.9)
    view = looking((2.2, 0.0, 0.5), 0.0)
    result = reach_among(robot, beside).reach(view)
    assert result.reason == ""


def test_only_columns_of_the_same_level_are_closed() -> None:
    terrain = terrain_where(lambda x, y: np.where(x < 0.0, 0.0, -4.0))
    closed = with_obstacles(terrain, [Obstacle(0.0, 0.0, 0.5, 0.0, 1.0)])
    gone = np.isnan(closed.heights)
    for x, y, is_closed in ((-0.2, 0.0, True), (-0.7, 0.0, False), (0.2, 0.0, False)):
        assert gone[tuple(closed.cells_of((x, y)))] == is_closed
    assert not np.isnan(terrain.heights).any(), "the terrain itself stays as it was"
    assert with_obstacles(terrain, []) is terrain


def test_obstacles_beyond_the_edge_change_nothing() -> None:
    terrain = terrain_where(lambda x, y: 0.0 * x)
    closed = with_obstacles(terrain, [Obstacle(50.0, 0.0, 0.5, 0.0, 1.0)])
    assert not np.isnan(closed.heights).any()


@pytest.mark.parametrize("numbers", [(0, 0, 0, 0, 1), (0, 0, 1, 1, 1), (np.nan, 0, 1, 0, 1)])
def test_what_is_no_cylinder_is_refused(numbers: tuple[float, ...]) -> None:
    x, y, radius, bottom, top = numbers
    with pytest.raises(InvalidInputError, match="obstacle"):
        Obstacle(x, y, radius, bottom, top)
