"""Parameters of the stereo range sensor."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from infomap_ros.errors import ConfigError
from infomap_ros.geometry.config import check_config, parameter, setting


@dataclass(frozen=True)
class StereoConfig:
    """Matcher, filters and noise model of `StereoRangeSensor`.

    The defaults of the noise model are fitted by `stereo.calibration`; docs/results/stereo_noise.md
    shows the fit.

    Raises:
        ConfigError: a value is out of range, or two values contradict each other.
    """

    min_depth: float = parameter(
        0.5, "Nearest depth that must be measured; sets the largest disparity.", unit="m", low=0.01
    )
    max_depth: float = parameter(
        15.0, "Farthest depth that is measured; sets the smallest disparity.", unit="m", low=0.02
    )
    max_search: float = setting(
        0.35,
        "Largest number of disparities, as a share of the image width. Where it does not reach "
        "from max_depth to min_depth, the nearest measurable depth grows.",
        low=0.02,
        high=0.8,
    )
    extend_search: bool = setting(
        True,
        "Match the outer columns too, some of whose candidates lie outside the right image. "
        "Costs matching time in proportion to the disparities searched.",
    )
    matcher: str = parameter(
        "sgbm_3way",
        "Variant of semi-global matching: 3 or 5 paths, from above and from below, or 8 paths over "
        "the whole image.",
        choices=("sgbm_3way", "sgbm", "sgbm_hh"),
    )
    block_size: int = setting(5, "Side of the matching window, odd.", unit="px", low=1, high=21)
    smoothness_small: ClassVar[int] = 8
    """Penalty of a disparity step of 1 px, per pixel of the block (P1)."""
    smoothness_large: int = setting(
        32, "Penalty of a larger disparity step, per pixel of the block (P2).", low=2, high=1000
    )
    prefilter_cap: ClassVar[int] = 0
    """Cap of the horizontal derivative before matching; 0 for OpenCV's default [gray levels]."""
    uniqueness: int = setting(
        10,
        "The best match must beat the second best by this margin.",
        unit="%",
        low=0,
        high=100,
    )
    left_right_tolerance: int = setting(
        1,
        "Largest difference between the disparity found from the left and from the right image, "
        "and between two left pixels that claim the same right pixel.",
        unit="px",
        low=1,
        high=100,
    )
    speckle_size: int = parameter(
        100,
        "Smaller connected patches of disparity are dropped; 0 keeps all.",
        unit="px",
        low=0,
        high=100000,
    )
    speckle_range: ClassVar[float] = 1.0
    """Neighbors that differ by less belong to one patch [px]."""
    edge_window: int = setting(
        5,
        "Pixels with a disparity jump or a hole within this window are dropped (foreground "
        "fattening); odd, 1 keeps all.",
        unit="px",
        low=1,
        high=31,
    )
    edge_threshold: float = setting(
        2.0,
        "Disparity range within edge_window that counts as a jump.",
        unit="px",
        low=0.25,
        high=100.0,
    )
    max_grazing_angle: float = setting(
        1.405,
        "A disparity range within edge_window that only a surface seen at a larger angle from its "
        "normal would have counts as a jump too...",
        unit="rad",
        low=0.1,
        high=1.55,
    )
    edge_noise: float = setting(
        1.0,
        "...but none up to this, which a match may have by chance.",
        unit="px",
        low=0.0,
        high=100.0,
    )
    min_texture: float = parameter(
        0.3,
        "Pixels whose neighborhood has a smaller horizontal gradient (rms) are dropped.",
        unit="gray levels/px",
        low=0.0,
        high=100.0,
    )
    min_contrast: float = setting(
        0.35,
        "Pixels whose mean squared horizontal gradient is less than this many times the "
        "photometric variance that the match leaves unexplained are dropped: images of nothing "
        "but sensor noise, as of the sky, have 0.2.",
        low=0.0,
        high=100.0,
    )
    min_support: float = setting(
        0.5,
        "Pixels that stand alone are dropped: so large a share of the 9 x 9 pixels about each must "
        "be kept by all other checks.",
        low=0.0,
        high=1.0,
    )
    refinement_window: int = setting(
        7,
        "Side of the window of the photometric sub-pixel step and of the matching quality, odd.",
        unit="px",
        low=3,
        high=31,
    )
    smoothing_window: int = setting(
        5,
        "Refined disparities are averaged over this window, odd, at most edge_window; 1 for none.",
        unit="px",
        low=1,
        high=15,
    )
    noise_model: str = parameter(
        "disparity",
        "disparity: sigma of every pixel's disparity from its matching quality, propagated to an "
        "anisotropic covariance. printed: equations (1)-(3) of Sujan and Dubowsky.",
        choices=("disparity", "printed"),
    )
    sigma_scale: float = parameter(
        0.127,
        "Disparity model: matching sigma at a residual of 1 gray level and texture 1 px wide.",
        unit="px",
        low=0.001,
        high=100.0,
    )
    sigma_residual_power: float = parameter(
        0.542, "Disparity model: exponent of the photometric residual.", low=0.0, high=3.0
    )
    sigma_texture_power: float = parameter(
        0.616, "Disparity model: exponent of the width of the texture.", low=0.0, high=3.0
    )
    sigma_floor: float = setting(
        0.05, "Disparity model: sigma is never smaller.", unit="px", low=0.001, high=10.0
    )
    pixel_sigma: float = setting(
        0.3,
        "Disparity model: standard deviation of the viewing ray across the image (the footprint "
        "of a pixel has 0.29).",
        unit="px",
        low=0.001,
        high=10.0,
    )
    printed_s: float = setting(
        0.293,
        "Printed model: intrinsic constant as a disparity error; S of eq. (1) is this over focal "
        "length [px] times baseline [m].",
        unit="px",
        low=0.001,
        high=100.0,
    )
    printed_t: tuple[float, ...] = setting(
        (0.131, 0.092, 1.0), "Printed model: T_x, T_y, T_z of eq. (1).", low=0.001, high=100.0
    )
    printed_n: float = setting(
        1.82, "Printed model: exponent n of the distance L in eq. (1).", low=0.5, high=4.0
    )
    printed_rho: tuple[float, ...] = setting(
        (0.0, 0.0, 0.0),
        "Printed model: correlations rho_xy, rho_xz, rho_yz of eq. (2), in the camera frame.",
        low=-0.99,
        high=0.99,
    )
    max_relative_sigma: float = setting(
        0.15,
        "Pixels whose disparity sigma is a larger share of their disparity from infinity are "
        "dropped: beyond it the second-order range statistics are not trustworthy.",
        low=0.01,
        high=0.3,
    )
    threads: int = parameter(2, "Threads for all that is not the matcher.", low=1, high=64)
    error_correlation: float = setting(
        0.41,
        "Mean correlation of the disparity errors of two pixels of one surface patch.",
        low=0.0,
        high=1.0,
    )

    def __post_init__(self) -> None:
        check_config(self)
        for name in ("block_size", "edge_window", "refinement_window", "smoothing_window"):
            if getattr(self, name) % 2 == 0:
                raise ConfigError(name, getattr(self, name), "an odd number")
        if self.smoothing_window > self.edge_window:  # would average over holes and depth edges
            limit = f"at most edge_window, {self.edge_window}"
            raise ConfigError("smoothing_window", self.smoothing_window, limit)
        if self.max_depth <= self.min_depth:
            raise ConfigError("max_depth", self.max_depth, f"more than min_depth {self.min_depth}")
        if self.smoothness_large <= self.smoothness_small:
            raise ConfigError(
                "smoothness_large",
                self.smoothness_large,
                f"more than smoothness_small {self.smoothness_small}",
            )
        self._check_triples()

    def _check_triples(self) -> None:
        for name in ("printed_t", "printed_rho"):
            if len(getattr(self, name)) != 3:
                raise ConfigError(name, getattr(self, name), "three numbers")
        xy, xz, yz = self.printed_rho
        if 1.0 + 2.0 * xy * xz * yz - xy * xy - xz * xz - yz * yz <= 0.0:
            raise ConfigError(
                "printed_rho", self.printed_rho, "correlations that can occur together"
            )
