"""Where an arm can hold its camera."""

from __future__ import annotations

import numpy as np

from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.motion.robot.robot_model import RobotModel
from infomap_ros.motion.robot.solid_extent import solid_extent

_POSTURES = 2000
_LEAST_HEIGHT = 0.15  # [m]; nearer to rough ground the arm would touch it


def camera_heights(robot: RobotModel) -> tuple[float, float]:
    """Lowest and highest camera that the arm can hold, above the ground of a level base [m].

    Sampled over the joint limits, so a little inside of what is possible. The ground is taken
    where the lowest solid of the robot ends.
    """
    postures = random_postures(robot, _POSTURES, np.random.default_rng(0))
    poses = robot.arm.camera_pose(postures)
    heights = poses[:, 2, 3] - robot_bottom(robot)
    return float(max(heights.min(), _LEAST_HEIGHT)), float(heights.max())


def random_postures(robot: RobotModel, count: int, rng: np.random.Generator) -> FloatArray:
    """Positions of the arm, uniform within its limits, shape (count, n) [rad or m]."""
    chain = robot.arm
    lower, upper = np.maximum(chain.lower, -np.pi), np.minimum(chain.upper, np.pi)
    return rng.uniform(lower, upper, (count, len(chain)))


def robot_bottom(robot: RobotModel) -> float:
    """Height of the robot's lowest point in the base frame [m], the joints near zero."""
    joints = {j.name: float(np.clip(0.0, j.lower, j.upper)) for j in robot.joints}
    solids = robot.solids_in(robot.base_frame, joints)
    return min((float(solid_extent(placed)[0][2]) for placed in solids), default=0.0)
