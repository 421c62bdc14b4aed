"""What stands in for the covariance of a pose that has none."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from infomap_ros.geometry.config import check_config, parameter
from infomap_ros.geometry.transforms import FloatArray


@dataclass(frozen=True)
class AssumedPoseConfig:
    """Uncertainty of a camera pose whose covariance is unknown.

    Raises:
        ConfigError: a value is out of its range.
    """

    default_position_sigma: float = parameter(
        0.02,
        "Standard deviation of the camera's position, along each axis, where its pose has no "
        "covariance.",
        unit="m",
        low=0.0,
        high=100.0,
    )
    default_rotation_sigma: float = parameter(
        0.01,
        "Standard deviation of the camera's rotation, about each axis, where its pose has no "
        "covariance.",
        unit="rad",
        low=0.0,
        high=3.2,
    )

    def __post_init__(self) -> None:
        check_config(self)

    def covariance(self) -> FloatArray:
        """Covariance of the pose, shape (6, 6), convention of `geometry.transforms`."""
        sigmas = [self.default_position_sigma] * 3 + [self.default_rotation_sigma] * 3
        return np.diag(np.square(sigmas))
