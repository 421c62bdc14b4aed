"""Robot models, and where they and what they carry can go."""

from infomap_ros.motion.robot_model import JointLimits, RobotModel

__all__ = ["JointLimits", "RobotModel"]
