"""Parameters of the tracker of fiducials."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import ClassVar

from infomap_ros.errors import ConfigError
from infomap_ros.geometry.config import check_config, setting
from infomap_ros.localization.fiducials.appearance import AppearanceConfig
from infomap_ros.localization.fiducials.optical_flow import OpticalFlowConfig


@dataclass(frozen=True)
class FiducialTrackerConfig:
    """How fiducials are followed.

    Raises:
        ConfigError: a value is out of its range.
    """

    template: int = setting(15, "Side of a fiducial's template, odd.", unit="px", low=7, high=41)
    min_correlation: ClassVar[float] = 0.8
    """A fiducial must have this normalized correlation with its template."""
    good_correlation: ClassVar[float] = 0.9
    """With this correlation it is well seen, and may give a new template."""
    max_shift: ClassVar[float] = 3.0
    """Flow and template may disagree by this much about where a fiducial is [px]."""
    max_sigma: ClassVar[float] = 0.7
    """Fiducials whose pixel is less certain than this are not believed: they slide along edges
    [px].
    """
    max_recalled_sigma: ClassVar[float] = 0.3
    """Likewise of fiducials that are found again: of those less certain every third was another
    thing [px].
    """
    max_warp: ClassVar[float] = 1.8
    """A template is renewed when it has to be stretched or shrunk by more than this factor."""
    search_radius: ClassVar[int] = 6
    """How far about its predicted place a fiducial is searched for that flow has lost [px]."""
    max_missed_views: int = setting(
        5, "A fiducial that was not seen in more consecutive views is given up.", low=0, high=1000
    )
    large_step: ClassVar[float] = 0.5
    """Share of fiducials that flow may lose before descriptors are compared."""
    direct_radius: ClassVar[float] = 12.0
    """A dormant fiducial that is expected within this is searched for by its template, otherwise
    by its descriptor [px].
    """
    sharp_share: ClassVar[float] = 0.7
    """Where fewer of the fiducials that flow has found are well seen, the image is taken to be
    blurred, and blurred templates are tried.
    """
    sigma_factor: ClassVar[float] = 3.0
    """Calibrated multiple of the sigma that image noise leaves."""
    sigma_floor: float = setting(
        0.05, "Pixel sigmas are never smaller.", unit="px", low=0.001, high=10.0
    )
    flow: OpticalFlowConfig = field(default_factory=OpticalFlowConfig)
    appearance: AppearanceConfig = field(default_factory=AppearanceConfig)

    def __post_init__(self) -> None:
        check_config(self)
        if self.template % 2 == 0:
            raise ConfigError("template", self.template, "an odd number")
