"""How fiducial_localization is set up for the simulated robot."""

from __future__ import annotations

from typing import Any

from infomap_ros.localization.dead_reckoning import DeadReckoningConfig
from infomap_ros.localization.localizer_config import LocalizerConfig
from infomap_ros.localization.target.config import TargetConfig
from infomap_ros.nodes.common.parameters import parameter_values
from infomap_ros.simulation.exploring.self_localisation import SelfLocalisationConfig

IMAGE_RATE = 2.0
"""Pairs per simulated second, so that the arm turns the cameras by little between two [Hz]."""


def simulated_localisation() -> dict[str, Any]:
    """Parameters of fiducial_localization in which the simulated robot is not as any other.

    The target is the board of the simulated worlds.
    """
    config = SelfLocalisationConfig()
    values: dict[str, Any] = {}
    for value, usual, prefix in (
        (config.localizer, LocalizerConfig(), ""),
        (config.motion, DeadReckoningConfig(), "motion_noise."),
        (config.target, TargetConfig(), "target."),
    ):
        defaults = parameter_values(usual, prefix)
        given = parameter_values(value, prefix)
        values |= {name: each for name, each in given.items() if each != defaults[name]}
    return values
