"""Robot models, and where they and what they carry can go."""

from infomap_ros import names_on_demand

_PLACES = {"RobotModel": "robot.robot_model", "solve_ik": "arm.inverse_kinematics"}
__getattr__ = names_on_demand(__name__, _PLACES | {"BasePlanner": "base.base_planner"})
