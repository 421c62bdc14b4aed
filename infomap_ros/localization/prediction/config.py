"""The parameters of the prediction of pose errors."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from infomap_ros.geometry.config import check_config, setting


@dataclass(frozen=True)
class ErrorPredictionConfig:
    """How paths and sightings are modeled.

    Raises:
        ConfigError: a value is out of its range.
    """

    waypoints: int = setting(
        5,
        "Camera poses on a path from which fiducials are looked at, its end included.",
        low=1,
        high=50,
    )
    pixel_sigma: float = setting(
        0.5, "Standard deviation of a tracked pixel.", unit="px", low=0.01, high=20.0
    )
    disparity_sigma: float = setting(
        0.3, "Standard deviation of a fiducial's disparity.", unit="px", low=0.01, high=20.0
    )
    farthest: float = setting(
        6.0, "Largest depth at which a fiducial is tracked.", unit="m", low=0.1, high=1000.0
    )
    fiducials: int = setting(
        60,
        "Of the known fiducials, so many are looked at; where there are more, each stands for "
        "several.",
        low=1,
        high=10_000,
    )
    surface_points: int = setting(
        40,
        "So many points of the mapped surface stand for fiducials that will be found on the way.",
        low=0,
        high=10_000,
    )
    unseen_points: ClassVar[int] = 120
    """At most so many points stand for fiducials in unknown space: those that are known, turned
    about the vertical. 0: a camera that looks there is taken to find none.
    """

    def __post_init__(self) -> None:
        check_config(self)
