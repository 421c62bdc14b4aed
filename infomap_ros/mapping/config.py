"""Configuration of the voxel map."""

from __future__ import annotations

import math
from dataclasses import dataclass

from infomap_ros.errors import ConfigError
from infomap_ros.geometry.config import check_config, parameter, setting
from infomap_ros.stereo.config import StereoConfig

LOG_ODDS_QUANTUM = 0.25
"""Step in which occupancy evidence is counted [nats]."""

SHARED_LOG_ODDS_LIMIT = 20
"""Occupancy that is told to others is clipped to +- this many quanta (p = 0.0067 .. 0.9933)."""

NOT_OBSERVED = -128
"""In place of such evidence: of this voxel nothing is known any more."""


@dataclass(frozen=True)
class VoxelMapConfig:
    """Parameters of a `VoxelMap`.

    Raises:
        ConfigError: a value is out of its range.
    """

    voxel_size: float = parameter(0.05, "Edge length of a voxel.", unit="m", low=1e-4, high=10.0)
    max_range: float = parameter(
        5.0,
        "Points farther from the sensor are not mapped; their rays free space up to here.",
        unit="m",
        low=0.01,
        high=1000.0,
    )
    probability_hit: float = setting(
        0.9,
        "Occupancy probability that one scan gives a voxel in which a surface certainly lies.",
        low=0.53,
        high=0.999,
    )
    probability_miss: float = setting(
        0.18,
        "Occupancy probability that one scan gives a voxel which it sees through. The default "
        "makes a voxel free (below 0.05) after two looks.",
        low=0.001,
        high=0.47,
    )
    association_sigmas: float = setting(
        3.0,
        "A point informs every voxel within this many standard deviations along its surface "
        "normal, so that noise does not decide which voxel learns of it.",
        low=0.0,
        high=6.0,
    )
    association_limit: float = setting(
        3.0, "Limit of that distance, in voxels.", low=0.0, high=64.0
    )
    free_gap: float = setting(
        0.8660254,
        "A scan without a camera frees nothing so near to the tangent plane of a surface. The "
        "default is half a voxel's diagonal; 0 is for a sensor without noise whose surfaces are "
        "faces of voxels.",
        unit="voxels",
        low=0.0,
        high=10.0,
    )
    error_correlation: float = StereoConfig.error_correlation
    """Correlation of the range errors of neighboring points of a scan that does not say it: the
    variance of a voxel's mean of n points is sigma^2 (c + (1 - c) / n). No parameter: clouds say
    it. 0 is for a sensor whose points are independent."""
    default_sigma: float = setting(
        0.02,
        "Standard deviation of a point, along each axis, when no covariance comes with it.",
        unit="m",
        low=1e-5,
        high=10.0,
    )
    memory_limit: float = parameter(
        8.0,
        "A scan that would make the map larger than this is refused and the map stays as it is.",
        unit="GB",
        low=0.001,
        high=1024.0,
    )
    threads: int = parameter(1, "Threads that integrate one scan.", low=1, high=64)

    def __post_init__(self) -> None:
        check_config(self)
        if not 0.0 <= self.error_correlation <= 1.0:
            raise ConfigError("error_correlation", self.error_correlation, "0 to 1")

    @property
    def hit_quanta(self) -> int:
        """Evidence of a hit in quanta, at least 1."""
        return max(1, _quanta(self.probability_hit))

    @property
    def miss_quanta(self) -> int:
        """Evidence of a miss in quanta, at most -1."""
        return min(-1, _quanta(self.probability_miss))


def _quanta(probability: float) -> int:
    return round(math.log(probability / (1.0 - probability)) / LOG_ODDS_QUANTUM)
