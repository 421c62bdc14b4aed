"""Robot models, and where they and what they carry can go."""

from infomap_ros.motion.chain import KinematicChain
from infomap_ros.motion.inverse_kinematics import (
    IkBatch,
    IkConfig,
    IkResult,
    solve_ik,
    solve_ik_batch,
)
from infomap_ros.motion.joint_limits import JointLimits
from infomap_ros.motion.robot_model import RobotModel

__all__ = [
    "IkBatch",
    "IkConfig",
    "IkResult",
    "JointLimits",
    "KinematicChain",
    "RobotModel",
    "solve_ik",
    "solve_ik_batch",
]
