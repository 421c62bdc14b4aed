"""A path planned by OMPL, driven by the simulated rover past a box."""

from __future__ import annotations

import numpy as np

from infomap_ros.geometry import invert_transform, make_transform
from infomap_ros.motion import BasePlanner
from infomap_ros.simulation.body.drive_train import planar
from infomap_ros.simulation.cameras.stereo_camera import StereoCameraConfig
from infomap_ros.simulation.simulator import Simulator, SimulatorConfig
from infomap_ros.simulation.worlds.builder import SceneBuilder, World
from infomap_ros.simulation.worlds.terrain import Terrain

from .grounds import ROVER, ground, rover

BOX, MIDDLE = np.array([0.3, 1.0, 0.6]), np.array([0.8, 0.25])
GOAL = np.array([1.6, 0.3, 0.0])
CONFIG = SimulatorConfig(camera=StereoCameraConfig(width=64, height=48, supersampling=1))


def world_with_box() -> World:
    """Level ground with a box ahead of the robot."""
    builder = SceneBuilder(Terrain(np.zeros((41, 41)), 4.0))
    grey = np.full((64, 64, 3), 128, np.uint8)
    builder.add_ground_material("ground", grey, 1.0)
    builder.add_material("paint", grey)
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
