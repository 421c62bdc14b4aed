"""The parameters of the prediction of pose errors."""

from __future__ import annotations

from dataclasses import dataclass, field

from infomap_ros.geometry.config import check_config, parameter
from infomap_ros.localization.dead_reckoning import DeadReckoningConfig


@dataclass(frozen=True)
class ErrorPredictionConfig:
    """How ways and sightings are modelled.

    Raises:
        ConfigError: a value is out of its range.
    """

    waypoints: int = parameter(
        5, "Places on a way from which fiducials are looked at, its end included.", low=1, high=50
    )
    pixel_sigma: float = parameter(
        0.5, "Standard deviation of a tracked pixel.", unit="px", low=0.01, high=20.0
    )
    nearest: float = parameter(
        0.3, "Smallest depth at which a fiducial is measured.", unit="m", low=0.0, high=100.0
    )
    farthest: float = parameter(
        6.0, "Largest depth at which a fiducial is tracked.", unit="m", low=0.1, high=1000.0
    )
    border: float = parameter(
        10.0, "So near to the edge of the image nothing is tracked.", unit="px", low=0.0, high=500.0
    )
    tolerance: float = parameter(
        6.0,
        "A ray may end so far before a fiducial: along flat lines of sight it meets the voxels of "
        "the fiducial's own surface early.",
        unit="voxels",
        low=0.0,
        high=100.0,
    )
    fiducials: int = parameter(
        60,
        "Of the known fiducials, so many are looked at; where there are more, each stands for "
        "several.",
        low=1,
        high=10_000,
    )
    cell: float = parameter(
        0.5,
        "What hides a fiducial from a place hides it from all places in a cube of this size.",
        unit="m",
        low=0.001,
        high=10.0,
    )
    surface_points: int = parameter(
        40,
        "So many points of the mapped surface stand for fiducials that will be found on the way.",
        low=0,
        high=10_000,
    )
    unseen_points: int = parameter(
        120,
        "At most so many points stand for fiducials in unknown space: those that are known, turned "
        "about the vertical. 0: a camera that looks there is taken to find none.",
        low=0,
        high=10_000,
    )
    motion: DeadReckoningConfig = field(default_factory=DeadReckoningConfig)

    def __post_init__(self) -> None:
        check_config(self)
