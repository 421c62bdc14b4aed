"""Paths of the arm around obstacles, looked at densely and without the planner's own margin."""

from __future__ import annotations

import numpy as np
import pytest

from infomap_ros.errors import InvalidInputError
from infomap_ros.motion.arm.arm_path import ArmPathConfig, plan_arm_path
from infomap_ros.motion.collision.body import CollisionBody
from infomap_ros.motion.collision.checker import CollisionChecker
from infomap_ros.motion.robot.robot_model import RobotModel
from infomap_ros.motion.route import ArmPath

from .bodies import rover
from .scenes import field_where

BASE = np.eye(4)


@pytest.fixture(scope="module")
def robot() -> RobotModel:
    return rover()


@pytest.fixture(scope="module")
def body(robot: RobotModel) -> CollisionBody:
    return CollisionBody.from_robot(robot)


def shelf(x, y, z):
    boards = (abs(z - 0.25) < 0.03) | (abs(z - 0.75) < 0.03)
    return (x > 0.45) & (x < 0.95) & (abs(y) < 0.5) & boards


def wall_with_a_gap(x, y, z):
    """A wall to the left of the robot with a window in it."""
    window = (abs(x - 0.1) < 0.2) & (abs(z - 0.45) < 0.2)
    return (abs(y - 0.45) < 0.03) & ~window


def is_free_all_along(checker: CollisionChecker, path: ArmPath) -> bool:
    """Spheres of the moving links against the voxels at 8 configurations between all knots."""
    body = checker.body
    link_of = np.repeat(np.arange(len(body.links)), np.diff(body.arrays.starts))
    moving = np.isin(link_of, body.moving_links)
    shares = np.linspace(0, 1, 8)[:, None]
    for first, second in zip(path.positions, path.positions[1:], strict=False):
        for q in first + shares * (second - first):
            spheres = body.spheres(q, BASE)[moving]
            if not checker.field.spheres_clear(spheres[:, :3], spheres[:, 3]).all():
                return False
    return True


@pytest.mark.parametrize("obstacle", [shelf, wall_with_a_gap])
def test_paths_are_free_all_along(
    robot: RobotModel, body: CollisionBody, obstacle: object, rng: np.random.Generator
) -> None:
    checker = CollisionChecker(body, field_where(obstacle))
    qs = rng.uniform(robot.arm.lower, robot.arm.upper, (400, 4))
    qs = qs[checker.are_free(qs, BASE)]
    pairs = zip(qs[::2], qs[1::2], strict=False)
    blocked = [pair for pair in pairs if checker.contact_between(*pair, BASE)][:8]
    assert len(blocked) >= 4
    for start, goal in blocked:
        path = plan_arm_path(checker, start, goal, BASE)
        assert path.converged, path.reason
        np.testing.assert_array_equal(path.positions[[0, -1]], [start, goal])
        assert is_free_all_along(checker, path)


def test_camera_goes_through_the_gap(body: CollisionBody) -> None:
    """From in front of the wall to its far side, where only the window leads."""
    checker = CollisionChecker(body, field_where(wall_with_a_gap))
    through = np.array([1.5, 1.14, 0.44, 0.02])
    assert not checker.contact(through, BASE)
    camera = checker.body.chain.camera_pose(through)
    assert camera[1, 3] > 0.5
    path = plan_arm_path(checker, np.zeros(4), through, BASE)
    assert path.converged, path.reason
    assert is_free_all_along(checker, path)


def test_free_path_is_straight_and_keeps_the_limits(body: CollisionBody) -> None:
    checker = CollisionChecker(body, field_where(lambda x, y, z: x > 1.5))
    start, goal = np.zeros(4), np.array([1.0, -0.5, 0.4, 0.2])
    path = plan_arm_path(checker, start, goal, BASE)
    shares = path.positions[:, :1]
    np.testing.assert_allclose(path.positions, shares * goal, atol=1e-12)
    assert path.joint_travel == pytest.approx(1.0)


def test_result_depends_on_the_seed_alone(body: CollisionBody) -> None:
    checker = CollisionChecker(body, field_where(wall_with_a_gap))
    start, goal = np.zeros(4), np.array([1.37, 1.12, 0.48, -1.77])
    paths = [plan_arm_path(checker, start, goal, BASE, seed=5).positions for _ in range(2)]
    assert len(paths[0]) > 2
    np.testing.assert_array_equal(*paths)


def test_effort_is_counted_in_samples(body: CollisionBody) -> None:
    """One sample is not enough for the path through the window, and the reason says so."""
    checker = CollisionChecker(body, field_where(wall_with_a_gap))
    start, goal = np.zeros(4), np.array([1.37, 1.12, 0.48, -1.77])
    path = plan_arm_path(checker, start, goal, BASE, ArmPathConfig(samples=1), seed=5)
    assert not path.converged
    assert "in 1 samples" in path.reason
    assert plan_arm_path(checker, start, goal, BASE, ArmPathConfig(samples=4000), seed=5).converged


def test_goal_in_an_obstacle_is_refused_by_name(body: CollisionBody) -> None:
    checker = CollisionChecker(body, field_where(lambda x, y, z: x > 0.5))
    path = plan_arm_path(checker, np.zeros(4), [0.0, 1.5, 0.0, 0.0], BASE)
    assert not path.converged and len(path.positions) == 0
    assert path.reason.startswith("the goal touches: arm_") and "with the map at" in path.reason


def test_goal_beyond_the_limits_is_refused_by_name(body: CollisionBody) -> None:
    checker = CollisionChecker(body, field_where(lambda x, y, z: x > 1.5))
    path = plan_arm_path(checker, np.zeros(4), [0.0, 0.0, 2.9, 0.0], BASE)
    assert path.reason == "the goal is beyond the limits of arm_elbow_joint"


def test_search_ends_where_there_is_no_path(body: CollisionBody) -> None:
    """Walls left and right: the arm leans forwards or backwards, never from one to the other."""
    checker = CollisionChecker(
        body, field_where(lambda x, y, z: (abs(y) > 0.12) & (abs(z - 0.5) < 0.7) | (z > 0.5))
    )
    start, goal = np.array([0.0, 1.4, 0.4, -0.4]), np.array([np.pi - 0.3, 1.4, 0.4, -0.4])
    path = plan_arm_path(checker, start, goal, BASE, ArmPathConfig(samples=6000))
    assert not path.converged
    assert path.reason


def test_start_that_touches_the_map_may_be_left(body: CollisionBody) -> None:
    checker = CollisionChecker(body, field_where(lambda x, y, z: x > 0.2))
    assert checker.contact(np.zeros(4), BASE)
    path = plan_arm_path(checker, np.zeros(4), [0.0, -1.2, 0.0, -0.4], BASE)
    assert path.converged, path.reason


def test_malformed_input_is_named(body: CollisionBody) -> None:
    checker = CollisionChecker(body, field_where(shelf))
    with pytest.raises(InvalidInputError, match="q_start"):
        plan_arm_path(checker, np.zeros(2), np.zeros(4), BASE)
