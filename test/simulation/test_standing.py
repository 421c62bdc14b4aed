"""A robot whose wheels stand stays where it is while its arm moves."""

from __future__ import annotations

import numpy as np

from infomap_ros.geometry.resources import find_share
from infomap_ros.simulation.body.robot import read_description
from infomap_ros.simulation.simulator import Simulator
from infomap_ros.simulation.worlds.scenes import make_world

JOINTS = ("arm_pan_joint", "arm_shoulder_joint", "arm_elbow_joint", "arm_wrist_joint")
LOWEST, HIGHEST = (-2.5, -1.2, 0.2, -0.5), (2.5, 0.3, 1.8, 0.5)  # [rad]
FASTEST = 0.6  # [rad/s], on average


def test_motions_of_the_arm_do_not_shift_the_base() -> None:
    simulator = Simulator(
        make_world("cave", seed=2), read_description(find_share("config/rover.urdf"))
    )
    rng, begin = np.random.default_rng(0), simulator.true_pose()
    joints = np.array([0.0, -0.35, 0.65, 0.0])
    for _ in range(10):
        goal = rng.uniform(LOWEST, HIGHEST)
        shares = np.linspace(0.0, 1.0, 20)[1:]
        knots = joints + np.outer(shares**2 * (3.0 - 2.0 * shares), goal - joints)
        times = 1.5 * max(1.0, float(np.abs(goal - joints).max()) / FASTEST) * shares
        simulator.follow_arm_trajectory(JOINTS, knots, times)
        while simulator.is_moving:
            simulator.step(0.1)
        joints = goal
    moved = np.linalg.inv(begin) @ simulator.true_pose()
    assert np.linalg.norm(moved[:3, 3]) < 0.003
    assert abs(np.arctan2(moved[1, 0], moved[0, 0])) < 0.002
