"""Configuration of what a view is expected to tell."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from infomap_ros.geometry import PlacedSolid, StereoRig
from infomap_ros.geometry.config import check_config, parameter
from infomap_ros.mapping import VoxelMapConfig

DISPARITY_SIGMA = 0.2
"""Standard deviation of a disparity that a pair is expected to measure [px]."""


@dataclass(frozen=True)
class InformationConfig:
    """How rays are laid, what the sensor can tell from afar, and what hides what.

    The noise law is that of eq. (1) of Sujan and Dubowsky (2005), ``sigma = S L^n`` of the distance
    L, and does not depend on the image that a camera of the same opening happens to have: a view's
    bits are the same for the full and for a reduced image.

    Raises:
        ConfigError: a value is out of its range.
    """

    ray_spacing: float = parameter(
        0.0125,
        "Largest angle between neighboring rays. Finer rays change nothing but the sampling error.",
        unit="rad",
        low=1e-4,
        high=0.5,
    )
    min_range: float = parameter(
        0.3, "Nearest distance at which the sensor measures.", unit="m", low=0.0, high=100.0
    )
    range_noise: float = parameter(
        0.004,
        "Standard deviation of the range of one pixel at 1 m, S of eq. (1); for a stereo pair "
        "disparity sigma / (focal length x baseline).",
        unit="m",
        low=0.0,
        high=10.0,
    )
    range_exponent: ClassVar[float] = 2.0
    """Growth of that deviation with distance, n of eq. (1)."""
    pixel_angle: float = parameter(
        0.002, "Angle between the sensor's own pixels.", unit="rad", low=1e-5, high=0.5
    )
    certain_probability: float = parameter(
        0.05,
        "A known voxel less likely occupied than this counts as empty, and one less likely empty "
        "than this as solid: neither has anything more to tell.",
        low=1e-4,
        high=0.45,
    )
    known_weight: float = parameter(
        0.25,
        "Weight of the bits of known voxels. What one scan told of the voxels along a ray is right "
        "or wrong together, so that less is left to learn of them than the sum of their entropies. "
        "1 counts the sum, as `VoxelMap.entropy_bits` does.",
        low=0.0,
        high=1.0,
    )
    min_visibility: ClassVar[float] = 0.05
    """Where a place can be seen with a lower probability, it counts as hidden."""
    unknown_occlusion: float = parameter(
        0.0,
        "Probability that unknown space hides what is one max_range behind it. With 0 only known "
        "obstacles hide something, as in the paper, and the information grows with every unknown "
        "voxel in view.",
        low=0.0,
        high=0.99,
    )
    hiding_probability: float = parameter(
        0.5,
        "A known voxel less likely occupied than this hides nothing.",
        low=0.5,
        high=0.999,
    )
    predict_unknown: bool = parameter(
        False,
        "Whether unknown voxels near known ones have the average probability of their neighbors "
        "instead of 0.5. They then tell less than 1 bit, and hide what is behind them where they "
        "are more likely occupied than not.",
    )

    wanted_sigma: float = parameter(
        0.0,
        "Standard deviation of a surface along its normal that suffices. What a view is expected "
        "to tell about where less precise surfaces lie then counts too; 0 counts none of it.",
        unit="m",
        low=0.0,
        high=10.0,
    )
    coarse_sigma: float = parameter(
        0.0,
        "Standard deviation that suffices instead outside of `fine_places`, where that is larger.",
        unit="m",
        low=0.0,
        high=10.0,
    )
    fine_places: tuple[PlacedSolid, ...] = ()
    """Where `wanted_sigma` is asked for, map frame; everywhere where there are none."""
    planar: bool = parameter(
        False,
        "The map is one layer of voxels, along which the camera looks: a ray stands for a sector "
        "of the layer, not for a pyramid, and near space counts accordingly more.",
    )

    def __post_init__(self) -> None:
        check_config(self)

    @classmethod
    def of_stereo(
        cls, rig: StereoRig, disparity_sigma: float = DISPARITY_SIGMA, min_range: float = 0.5
    ) -> InformationConfig:
        """Configuration with the noise law of a rectified pair.

        About surfaces and depth edges stereo leaves voxels with a part of a hit and some misses.
        Several in a row would hide for good what is behind a gap that they are in, so a voxel
        hides from one whole hit on.

        Args:
            rig: the pair, with its full image.
            disparity_sigma: standard deviation of a disparity [px].
            min_range: nearest distance that its disparity search reaches [m].
        """
        focal_length = rig.left.fx
        return cls(
            min_range=min_range,
            range_noise=disparity_sigma / (focal_length * rig.baseline),
            pixel_angle=1.0 / focal_length,
            hiding_probability=VoxelMapConfig.probability_hit,
        )
