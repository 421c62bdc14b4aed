"""How fiducial_localization is set up for the simulated robot."""

from __future__ import annotations

from typing import Any

from infomap_ros.localization.dead_reckoning import DeadReckoningConfig
from infomap_ros.localization.localizer_config import LocalizerConfig
from infomap_ros.localization.target.config import TargetConfig
from infomap_ros.nodes.common.parameters import parameter_values
from infomap_ros.simulation.exploring.simulated_robot import (
    SKIDDING,
    SimulatedLocalizationConfig,
)


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
