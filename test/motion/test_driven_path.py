"""Paths planned by OMPL past a box: driven by the simulated rover, and beside the lattice's."""

from __future__ import annotations

import math

import numpy as np
import pytest

from infomap_ros.geometry import invert_transform, make_transform
from infomap_ros.motion.base import driven_path
from infomap_ros.motion.base.base_planner import BasePlanner
from infomap_ros.motion.base.drive_space import BasePath, BasePlannerConfig, DriveSpace, links_for
from infomap_ros.motion.base.path_following import PathFollower, PathFollowingConfig
from infomap_ros.simulation.body.base_motion import planar
from infomap_ros.simulation.cameras.stereo_camera import StereoCameraConfig
from infomap_ros.simulation.simulator import Simulator, SimulatorConfig
from infomap_ros.simulation.worlds.builder import SceneBuilder, World
from infomap_ros.simulation.worlds.terrain import Terrain

from .grounds import CELL, ROVER, ground, plane, rover

BOX, MIDDLE = np.array([0.3, 1.0, 0.6]), np.array([0.8, 0.25])
GOAL = np.array([1.6, 0.3, 0.0])
PERIOD = 0.02  # [s]
CONFIG = SimulatorConfig(camera=StereoCameraConfig(width=64, height=48, supersampling=1))


def world_with_box() -> World:
    """Level ground with a box ahead of the robot."""
    builder = SceneBuilder(Terrain(np.zeros((41, 41)), 4.0))
    gray = np.full((64, 64, 3), 128, np.uint8)
    builder.add_ground_material("ground", gray, 1.0)
    builder.add_material("paint", gray)
    builder.add_terrain("ground")
    builder.add_box("box", tuple(BOX), make_transform(np.eye(3), (*MIDDLE, 0.3)), "paint")
    return builder.compile()


def box_height(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """The same for the planner."""
    inside = (np.abs(x - MIDDLE[0]) <= 0.5 * BOX[0]) & (np.abs(y - MIDDLE[1]) <= 0.5 * BOX[1])
    return np.where(inside, BOX[2], 0.0)


def test_the_path_around_a_box_is_driven_without_contact() -> None:
    robot = Simulator(world_with_box(), ROVER.read_text(encoding="utf-8"), CONFIG)
    joints = robot.joint_state()
    vehicle = rover().with_joints(dict(zip(joints.names, joints.positions.tolist(), strict=True)))
    planner = BasePlanner(ground(box_height, 2.6), vehicle)
    path = planner.plan((0.0, 0.0, 0.0), GOAL)
    assert path.complete and path.method == "ompl"
    assert path.length < planner.plan((0.0, 0.0, 0.0), GOAL, samples=0).length

    robot.follow_base_path(path.poses)
    while robot.is_moving:
        robot.step(0.2)
        T_map_base = invert_transform(robot.T_world_odom) @ robot.true_pose()
        robot.correct_path(robot.odometry().transform @ invert_transform(T_map_base))

    assert robot.problem == ""
    assert robot.contacts == 0
    np.testing.assert_allclose(planar(robot.true_pose()), GOAL, atol=0.06)


def driving_time(path: BasePath) -> float:
    """Time that an ideal vehicle takes along a path with the simulator's path follower [s]."""
    follower, pose = PathFollower(path.poses, PathFollowingConfig()), path.poses[0].copy()
    for step in range(10_000):
        speed, rate = follower.velocity(pose)
        if follower.done:
            return step * PERIOD
        pose += PERIOD * np.array([speed * math.cos(pose[2]), speed * math.sin(pose[2]), rate])
    raise AssertionError("the path follower does not arrive")


def turns_in_place(path: BasePath) -> int:
    moving = np.hypot(*np.diff(path.poses[:, :2], axis=0).T) > 1e-6
    return int((moving[:-1] & ~moving[1:]).sum() + (~moving[:1]).sum())


def test_no_path_takes_longer_to_drive_than_the_one_of_the_lattice() -> None:
    """Goals all around a box, any heading: with fewer stops or as many for less way."""
    planner, rng = BasePlanner(ground(box_height, 2.6), rover()), np.random.default_rng(3)
    times, turns, methods = [], [], []
    for angle in rng.uniform(-math.pi, math.pi, 8):
        goal = (*(MIDDLE + 1.3 * np.array([math.cos(angle), math.sin(angle)])), rng.uniform(-3, 3))
        pair = planner.plan((0.0, 0.0, 0.0), goal, samples=0), planner.plan((0.0, 0.0, 0.0), goal)
        assert pair[0].complete and pair[1].complete
        assert pair[1].turning <= pair[0].turning + 1e-5
        times.append([driving_time(path) for path in pair])
        turns.append([turns_in_place(path) for path in pair])
        methods.append(pair[1].method)
    lattice, driven = np.array(times).T
    assert (driven <= lattice + PERIOD).all()
    assert np.median(driven) < np.median(lattice)
    assert np.mean(turns, axis=0)[1] <= np.mean(turns, axis=0)[0]
    assert methods.count("ompl") >= 4


@pytest.fixture(scope="module")
def open_field() -> driven_path.DrivenPath:
    config = BasePlannerConfig()
    space = DriveSpace(ground(plane(0.0, 0.0), 2.0), rover(), config)
    return driven_path.DrivenPath(space, links_for(config, CELL))


ANGLE = (np.array([-0.5, -0.5, 0.0]), np.array([0.5, -0.5, 0.0]), np.array([0.5, 0.5, math.pi / 2]))
"""Ahead, left by a right angle, ahead: shape (3,) each."""


def test_places_beside_a_straight_line_are_left_out(open_field, rng) -> None:
    """As far as OMPL's curves leave them: each would be a stop to turn."""
    bends = np.linspace(ANGLE[0], ANGLE[1], 9)
    bends[1:-1] += rng.uniform(-1e-3, 1e-3, (7, 3))
    np.testing.assert_array_equal(open_field._thinned(bends), bends[[0, -1]])


def test_a_place_that_leads_around_something_is_kept() -> None:
    config = BasePlannerConfig()
    space = DriveSpace(ground(box_height, 2.6), rover(), config)
    path = driven_path.DrivenPath(space, links_for(config, CELL))
    around = np.array([(-0.2, 0.25, 0.0), (0.8, -1.5, 0.0), (1.8, 0.25, 0.0)])
    thinned = path._thinned(around)
    np.testing.assert_array_equal(thinned[:, :2], around[:, :2])
    assert space.fault_on(thinned) is None


@pytest.mark.parametrize(("bend", "is_taken"), [(0.05, False), (0.6, True)])
def test_a_shorter_path_is_driven_where_it_is_worth_its_stop(
    open_field, monkeypatch, bend, is_taken
) -> None:
    """A right angle cut off at both sides, with two stops instead of one and the same turning."""
    path = np.stack(ANGLE)
    cut = np.stack([
        path[0], path[1] - (bend, 0.0, 0.0), path[1] + (0.0, bend, math.pi / 4), path[2],
    ])  # fmt: skip
    monkeypatch.setattr(driven_path._Search, "shortened", lambda self, path: cut)
    monkeypatch.setattr(open_field, "_thinned", open_field._straightened)
    saved = 2.0 * bend - math.hypot(bend, bend)
    assert (saved > driven_path._STOP) == is_taken
    monkeypatch.setattr(driven_path._Search, "planned", lambda self, samples: None)
    found = open_field.better_than(path, 100)
    assert (found is not None) == is_taken


def test_a_path_that_turns_more_is_not_driven(open_field, monkeypatch) -> None:
    """A detour at one heading is cut off: for less length and cost, but with turns."""
    path = np.array([(-1.0, 0.0, 0.0), (1.0, 0.0, 0.0), (0.6, 0.0, 0.0)])
    turned = np.array([(-1.0, 0.0, 0.0), (-0.2, 0.1, 0.1), (0.6, 0.0, 0.0)])
    monkeypatch.setattr(driven_path._Search, "shortened", lambda self, path: turned)
    monkeypatch.setattr(driven_path._Search, "planned", lambda self, samples: None)
    monkeypatch.setattr(open_field, "_thinned", open_field._straightened)
    before, after = open_field._effort(path), open_field._effort(open_field._straightened(turned))
    assert after.cost < before.cost and after.turning > before.turning
    assert open_field.better_than(path, 100) is None
    monkeypatch.undo()
    assert len(open_field.better_than(path, 100)) == 2


def test_stops_are_turns_in_place_and_changes_of_direction() -> None:
    """Turn, ahead, ahead, turn by two steps, ahead, back, turn."""
    path = np.array([
        (0.0, 0.0, -0.1), (0.0, 0.0, 0.0), (0.1, 0.0, 0.0), (0.2, 0.0, 0.0), (0.2, 0.0, 0.8),
        (0.2, 0.0, math.pi / 2), (0.2, 0.1, math.pi / 2), (0.2, 0.05, math.pi / 2),
        (0.2, 0.05, 1.8),
    ])  # fmt: skip
    assert driven_path.stops_on(path) == 4
    assert driven_path.stops_on(path[1:4]) == 0
