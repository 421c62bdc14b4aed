"""What worlds with natural ground have in common: parameters, and a floor that is not even."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from infomap_ros.geometry.config import check_config, parameter
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.simulation.worlds.textures import spectral_noise


@dataclass(frozen=True)
class NaturalGroundConfig:
    """Parameters of a world with natural ground.

    Raises:
        ConfigError: a value is out of its range.
    """

    seed: int = parameter(7, "Seed of everything random in the world", low=0)
    spacing: float = parameter(
        0.035, "Distance of height field nodes", unit="m", low=0.01, high=0.5
    )
    relief: float = parameter(
        0.025, "Standard deviation of the floor's relief", unit="m", low=0.0, high=1.0
    )
    roughness: float = parameter(
        0.005, "Standard deviation of bumps below 0.4 m", unit="m", low=0.0, high=0.1
    )
    target_distance: float = parameter(
        1.6,
        "Distance of the board with tags from the start; 0 for none.",
        unit="m",
        low=0.0,
        high=10.0,
    )
    texture_size: int = parameter(
        2048, "Edge length of the ground texture", unit="px", low=64, high=8192
    )

    def __post_init__(self) -> None:
        """Validate all fields."""
        check_config(self)


def node_count(config: NaturalGroundConfig, half: float) -> int:
    """Nodes along an edge of the height field that reaches `half` [m] from its middle."""
    return round(2.0 * half / config.spacing) + 1


def uneven_floor(config: NaturalGroundConfig, n: int, rng: np.random.Generator) -> FloatArray:
    """Heights of a floor with relief and bumps, shape (n, n) [m]."""
    relief = config.relief * spectral_noise(n, 3.0, rng)
    return np.asarray(relief + config.roughness * spectral_noise(n, 1.6, rng))
