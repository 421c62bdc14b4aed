"""Robot models, and where they and what they carry can go."""

from infomap_ros.motion.arm.inverse_kinematics import (
    IkBatch,
    IkConfig,
    IkResult,
    solve_ik,
    solve_ik_batch,
)
from infomap_ros.motion.base.base_path import BasePath, BasePlannerConfig
from infomap_ros.motion.base.base_planner import BasePlanner
from infomap_ros.motion.base.standing_ground import with_standing_ground
from infomap_ros.motion.base.vehicle import Stance, StanceBatch, Vehicle
from infomap_ros.motion.base.vehicle_config import VehicleConfig
from infomap_ros.motion.robot.chain import KinematicChain
from infomap_ros.motion.robot.joint_limits import JointLimits
from infomap_ros.motion.robot.robot_model import RobotModel

__all__ = [
    "BasePath",
    "BasePlanner",
    "BasePlannerConfig",
    "IkBatch",
    "IkConfig",
    "IkResult",
    "JointLimits",
    "KinematicChain",
    "RobotModel",
    "Stance",
    "StanceBatch",
    "Vehicle",
    "VehicleConfig",
    "solve_ik",
    "solve_ik_batch",
    "with_standing_ground",
]
