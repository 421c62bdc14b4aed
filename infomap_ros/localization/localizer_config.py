"""Parameters of the localizer."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np

from infomap_ros.errors import ConfigError
from infomap_ros.geometry.config import check_config, parameter, setting
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.localization.fiducials.selection import FiducialSelectionConfig
from infomap_ros.localization.filter.config import FiducialFilterConfig
from infomap_ros.localization.target.scene_tags import SceneTagsConfig
from infomap_ros.mapping.scans.body import BodyFilterConfig


@dataclass(frozen=True)
class CalibrationConfig:
    """How exact the calibration of the camera is: standard deviations of what all views share.

    Raises:
        ConfigError: a value is out of its range.
    """

    disparity_offset: float = parameter(
        0.3,
        "Standard deviation of an offset of all disparities, by rectification and matching.",
        unit="px",
        low=0.0,
        high=100.0,
    )
    range_scale: float = setting(
        0.005, "Of a relative error of all ranges, as of the baseline.", low=0.0, high=1.0
    )
    focal_length: float = setting(
        0.005, "Of a relative error of the focal length.", low=0.0, high=1.0
    )

    def __post_init__(self) -> None:
        check_config(self)

    def sigmas(self, disparity_unit: float) -> FloatArray:
        """As the filter wants them, shape (3,); see `InvariantState`.

        Args:
            disparity_unit: of `RangeView`.
        """
        offset = self.disparity_offset * disparity_unit
        return np.array([offset, self.range_scale, self.focal_length])


@dataclass(frozen=True)
class LocalizerConfig:
    """When the localizer wants new fiducials, keeps a pose, and holds the camera to be lost.

    Raises:
        ConfigError: a value is out of its range.
    """

    wanted_fiducials: int = setting(
        70, "Fiducials that are followed at the same time.", low=8, high=1000
    )
    fewest_fiducials: int = setting(
        45, "With fewer in view, new ones are chosen.", low=5, high=1000
    )
    max_position_sigma: float = parameter(
        0.3,
        "The camera is lost when its position has a larger standard deviation along some axis.",
        unit="m",
        low=0.001,
        high=100.0,
    )
    max_coasting: float = parameter(
        60.0,
        "The camera is lost when its pose rests on the expected motion alone for longer, not "
        "counted while odometry and joints stand still.",
        unit="s",
        low=0.0,
        high=3600.0,
    )
    body: ClassVar[BodyFilterConfig] = BodyFilterConfig(margin=0.03, sigmas=0.0)
    """No fiducial is chosen this near to the robot's own body, or seen through it."""
    calibration: CalibrationConfig = field(default_factory=CalibrationConfig)
    selection: FiducialSelectionConfig = field(default_factory=FiducialSelectionConfig)
    filter: FiducialFilterConfig = field(default_factory=FiducialFilterConfig)
    scene_tags: SceneTagsConfig = field(default_factory=SceneTagsConfig)

    def __post_init__(self) -> None:
        check_config(self)
        if self.fewest_fiducials > self.wanted_fiducials:
            raise ConfigError("fewest_fiducials", self.fewest_fiducials, "<= wanted_fiducials")
