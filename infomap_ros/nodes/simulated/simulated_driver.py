"""How robot_driver is set up for the simulated robot, and the simulator for it."""

from __future__ import annotations

from importlib.util import find_spec
from typing import Any

from infomap_ros.nodes.simulated.simulator_actions import ARM_CONTROLLER
from infomap_ros.simulation.body.robot_setup import RobotSetupConfig


def has_actions() -> bool:
    """Whether the packages are installed whose actions simulator and robot_driver speak."""
    return all(find_spec(package) is not None for package in ("control_msgs", "nav2_msgs"))


def driven_simulator() -> dict[str, Any]:
    """Parameters of a simulator whose robot robot_driver moves."""
    return {"commands": "actions"}


def simulated_driver() -> dict[str, Any]:
    """Parameters of robot_driver for the controllers of the simulated rover."""
    joints = ", ".join(RobotSetupConfig().arm_joints)
    return {
        "arm": "follow_joint_trajectory",
        "controllers": [f"{ARM_CONTROLLER}: {joints}"],
        "base": "follow_path",
    }
