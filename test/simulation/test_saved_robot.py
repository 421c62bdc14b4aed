"""A simulated robot that is switched off goes on from where it stood."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from infomap_ros.errors import SimulationError
from infomap_ros.simulation.body.robot_account import RobotAccount
from infomap_ros.simulation.body.saved_robot import SavedRobot
from infomap_ros.simulation.simulator import Simulator, SimulatorConfig
from infomap_ros.simulation.worlds.builder import SceneBuilder, World
from infomap_ros.simulation.worlds.terrain import Terrain

ARM = ("arm_pan_joint", "arm_elbow_joint")


@pytest.fixture(scope="module")
def world() -> World:
    builder = SceneBuilder(Terrain(np.zeros((41, 41)), 4.0))
    builder.add_ground_material("ground", np.full((64, 64, 3), 128, np.uint8), 1.0)
    builder.add_material("paint", np.full((64, 64, 3), 200, np.uint8))
    builder.add_terrain("ground")
    return builder.compile()


@pytest.fixture(scope="module")
def driven(world: World, description: str) -> Simulator:
    """A robot after a drive and a motion of its arm."""
    robot = Simulator(world, description, SimulatorConfig(seed=3))
    robot.follow_base_path([(0.0, 0.0, 0.0), (0.4, 0.0, 0.0), (0.4, 0.0, 0.6)])
    settle(robot)
    robot.follow_arm_trajectory(ARM, [[0.7, 0.4]], [1.0])
    settle(robot)
    return robot


def settle(robot: Simulator) -> None:
    while robot.is_moving:
        robot.step(0.1)


def resumed(driven: Simulator, world: World, description: str, path: Path) -> Simulator:
    account = RobotAccount(driven, str(path), "flat")
    account.save_when_due()
    robot = Simulator(world, description, SimulatorConfig(seed=3))
    assert RobotAccount(robot, str(path), "flat").resume()
    return robot


def test_it_stands_where_it_stood_and_holds_its_arm(driven, world, description, tmp_path):
    robot = resumed(driven, world, description, tmp_path / "robot.json")
    np.testing.assert_allclose(robot.true_camera_pose(), driven.true_camera_pose(), atol=5e-5)
    robot.step(3.0)
    settle(robot)
    np.testing.assert_allclose(robot.true_camera_pose(), driven.true_camera_pose(), atol=2e-3)
    assert robot.problem == "" and robot.contacts == driven.contacts


def test_odometry_counts_on_and_time_does_not_go_back(driven, world, description, tmp_path):
    robot = resumed(driven, world, description, tmp_path / "robot.json")
    before, after = driven.odometry(), robot.odometry()
    assert after.stamp > before.stamp
    tilt_noise = 5.0 * driven.config.odometry.tilt_noise
    np.testing.assert_allclose(after.transform, before.transform, atol=tilt_noise)
    np.testing.assert_allclose(after.covariance, before.covariance, rtol=1e-9)
    np.testing.assert_array_equal(robot.T_world_odom, driven.T_world_odom)
    robot.follow_base_path([(0.4, 0.0, 0.6), (0.7, 0.2, 0.6)])
    settle(robot)
    distance = np.linalg.norm((robot.true_pose() - driven.true_pose())[:2, 3])
    assert distance == pytest.approx(np.hypot(0.3, 0.2), abs=0.06)


def test_what_is_not_its_own_file_is_refused(driven, world, description, tmp_path):
    path = tmp_path / "robot.json"
    RobotAccount(driven, str(path), "flat").save_when_due()
    robot = Simulator(world, description, SimulatorConfig())
    with pytest.raises(SimulationError, match="of another world"):
        RobotAccount(robot, str(path), "hilly").resume()
    foreign = dataclasses.replace(driven.saved, body={"positions": np.zeros(3)})
    with pytest.raises(SimulationError, match="another robot"):
        robot.resume(foreign, 0.0)
    path.write_text(path.read_text()[:-20])
    with pytest.raises(SimulationError, match=r"robot\.json"):
        SavedRobot.load(path)
    assert not RobotAccount(robot, str(tmp_path / "none.json"), "flat").resume()
    assert not RobotAccount(robot, "", "flat").resume()
