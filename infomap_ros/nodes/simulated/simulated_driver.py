"""How robot_driver is set up for the simulated robot, and the simulator for it.

How fiducial_localization is set up for the simulated robot.
"""

from __future__ import annotations

from importlib.util import find_spec
from typing import Any

from infomap_ros.localization.dead_reckoning import DeadReckoningConfig
from infomap_ros.localization.localizer_config import LocalizerConfig
from infomap_ros.localization.target.config import TargetConfig
from infomap_ros.nodes.common.parameters import parameter_values
from infomap_ros.nodes.simulated.simulator_actions import ARM_CONTROLLER
from infomap_ros.simulation.exploring.simulated_robot import (
    SKIDDING,
    SimulatedLocalizationConfig,
)

_ROVER = "config/rover.urdf"


def has_actions() -> bool:
    """Whether the packages are installed whose actions simulator and robot_driver speak."""
    return all(find_spec(package) is not None for package in ("control_msgs", "nav2_msgs"))


def driven_simulator() -> dict[str, Any]:
    """Parameters of a simulator whose robot robot_driver moves."""
    return {"commands": "actions"}


def simulated_driver(robot: str = "") -> dict[str, Any]:
    """Parameters of robot_driver for the controllers of the simulated robot.

    Args:
        robot: its file, or the name of one of ``config/robots``; the rover where empty.

    Raises:
        InfomapError: the file or the description in it cannot be used.
    """
    from infomap_ros.simulation.body.robot import read_description
    from infomap_ros.simulation.robots.ready_robot import ready_robot
    from infomap_ros.simulation.robots.robot_file import RobotFile

    known = RobotFile.read(robot) if robot else RobotFile(_ROVER)
    ready = ready_robot(read_description(known.description_path), known.setup)
    joints = ", ".join(ready.setup.arm_joints)
    if not joints:
        return {"arm": "none", "base": "follow_path"}
    return {
        "arm": "follow_joint_trajectory",
        "controllers": [f"{ARM_CONTROLLER}: {joints}"],
        "base": "follow_path",
    }


def simulated_localization(robot: str = "") -> dict[str, Any]:
    """Parameters of fiducial_localization in which the simulated robot is not as any other.

    The target is the board of the simulated worlds.

    Args:
        robot: its file; empty for the rover.
    """
    config = SimulatedLocalizationConfig()
    localizer = _unusual(config.localizer, LocalizerConfig(), "")
    target = _unusual(config.target, TargetConfig(), "target.")
    return localizer | simulated_motion_noise(robot) | target


def simulated_motion_noise(robot: str = "") -> dict[str, Any]:
    """Likewise how far the rover's odometry is trusted, for every node that has ``motion_noise.``.

    That of other robots is trusted as by default.
    """
    if robot:
        return {}
    return _unusual(SKIDDING, DeadReckoningConfig(), "motion_noise.")


def _unusual(value: object, usual: object, prefix: str) -> dict[str, Any]:
    defaults, given = parameter_values(usual, prefix), parameter_values(value, prefix)
    return {name: each for name, each in given.items() if each != defaults[name]}
