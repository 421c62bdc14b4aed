"""A short drive of a robot on level ground: whether it stands, turns and drives as it is told."""

from __future__ import annotations

from collections import Counter
from typing import NamedTuple

import numpy as np

from infomap_ros.motion.base.path_following import wrap
from infomap_ros.simulation.body.base_motion import planar
from infomap_ros.simulation.body.robot_setup import RobotSetupConfig
from infomap_ros.simulation.cameras.stereo_camera import StereoCameraConfig
from infomap_ros.simulation.simulator import Simulator, SimulatorConfig
from infomap_ros.simulation.worlds.builder import SceneBuilder, World
from infomap_ros.simulation.worlds.terrain import Terrain

_RATE, _SPEED = 0.5, 0.2  # [rad/s], [m/s]
_TURNING, _DRIVING, _STEP = 6.0, 3.0, 0.2  # [s]
_LEAST_SHARE = 0.5  # of the angle and the distance that it was told
_TILTED = 0.1  # [rad]


class TrialDrive(NamedTuple):
    """What a robot did that was told to turn about and to drive ahead.

    Attributes:
        stands: whether it stays upright where it stands.
        turns: whether it turned by half of what it was told at least.
        gain: of its wheels in turns, by geometry; see `DriveTrainConfig.turn_gain`.
        fitting_gain: the gain by which it would have turned as told; 0 if it hardly turned.
        problem: why it does not drive; empty if it does.
        contacts: what of it touched what it should not; empty for nothing.
    """

    stands: bool
    turns: bool
    gain: float
    fitting_gain: float
    problem: str
    contacts: str


def try_drive(description: str, setup: RobotSetupConfig) -> TrialDrive:
    """Let a robot turn for 6 s and drive for 3 s on level ground in simulation.

    Args:
        description: URDF text.
        setup: of the robot.

    Raises:
        InfomapError: the robot cannot be simulated; says why.
    """
    camera = StereoCameraConfig(width=32, height=24, supersampling=1)
    robot = Simulator(level_ground(), description, SimulatorConfig(robot=setup, camera=camera))
    if robot.true_pose()[2, 2] < np.cos(_TILTED):
        problem = "it tips over where it stands"
        return TrialDrive(False, False, robot.turn_gain, 0.0, problem, _contacts(robot))
    turned, before = 0.0, planar(robot.true_pose())[2]
    for _ in range(round(_TURNING / _STEP)):
        robot.command_velocity(0.0, _RATE)
        robot.step(_STEP)
        now = planar(robot.true_pose())[2]
        turned, before = turned + float(wrap(now - before)), now
    turns = turned > _LEAST_SHARE * _RATE * _TURNING
    gain = robot.fitting_turn_gain
    start = robot.true_pose()
    for _ in range(round(_DRIVING / _STEP)):
        robot.command_velocity(_SPEED, 0.0)
        robot.step(_STEP)
    driven = float(planar(np.linalg.inv(start) @ robot.true_pose())[0])
    problem = robot.problem
    if not problem and driven < _LEAST_SHARE * _SPEED * _DRIVING:
        problem = f"commanded to drive {_SPEED * _DRIVING:.1f} m ahead, it drives {driven:.2f} m"
    return TrialDrive(True, turns, robot.turn_gain, gain, problem, _contacts(robot))


def level_ground() -> World:
    """8 m x 8 m of gray ground, and nothing else."""
    builder = SceneBuilder(Terrain(np.zeros((9, 9)), 8.0))
    builder.add_ground_material("ground", np.full((64, 64, 3), 170, np.uint8), 1.0)
    builder.add_terrain("ground")
    return builder.compile()


def _contacts(robot: Simulator) -> str:
    counts = Counter((event.link, event.other) for event in robot.contact_events)
    pairs = [f"'{link}' touches '{other}'" for (link, other), _ in counts.most_common(3)]
    more = len(counts) - len(pairs)
    return ", ".join(pairs) + (f" and {more} more pairs" if more > 0 else "")
