"""Mass and center of mass of a robot with its arm in any posture."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pinocchio

from infomap_ros.errors import RobotModelError
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.motion.robot.robot_model import RobotModel


def mass_of(robot: RobotModel, joint_positions: Mapping[str, float]) -> tuple[float, FloatArray]:
    """Mass [kg] and center of mass, shape (3,) [m, base frame]; all joints must be there.

    Raises:
        RobotModelError: the robot has no inertials, or a joint is missing.
    """
    model = robot.model
    data = model.createData()
    pinocchio.forwardKinematics(model, data, robot.configuration(joint_positions))
    masses = np.array([float(inertia.mass) for inertia in model.inertias])
    if masses.sum() <= 0.0:
        raise RobotModelError(f"robot '{robot.name}' has no inertials, so no center of mass")
    centers = np.array(
        [pose.act(i.lever) for pose, i in zip(data.oMi, model.inertias, strict=True)]
    ).reshape(-1, 3)
    center = (masses @ np.where(masses[:, None] > 0.0, centers, 0.0)) / masses.sum()
    root = str(model.frames[1].name)
    T_base_root = robot.forward_kinematics(joint_positions, root)
    return float(masses.sum()), T_base_root[:3, :3] @ center + T_base_root[:3, 3]
