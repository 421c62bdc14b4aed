"""Parameters of the stereo range sensor."""

from __future__ import annotations

from dataclasses import dataclass

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
    matcher: str = parameter(
        "sgbm_3way",
        "Variant of semi-global matching: 3 or 5 paths, from above and from below, or 8 paths over "
        "the whole image.",
        choices=("sgbm_3way", "sgbm", "sgbm_hh"),
    )
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
    max_grazing_angle: float = setting(
        1.405,
        "Where disparities change as only a surface seen at a larger angle from its normal would "
        "have it, the pixels are dropped.",
        unit="rad",
        low=0.1,
        high=1.55,
    )
    min_texture: float = parameter(
        0.3,
        "Pixels whose neighborhood has a smaller horizontal gradient (rms) are dropped.",
        unit="gray levels/px",
        low=0.0,
        high=100.0,
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
    threads: int = parameter(2, "Threads for all that is not the matcher.", low=1, high=64)
    error_correlation: float = setting(
        0.41,
        "Mean correlation of the disparity errors of two pixels of one surface patch.",
        low=0.0,
        high=1.0,
    )

    def __post_init__(self) -> None:
        check_config(self)
        if self.max_depth <= self.min_depth:
            raise ConfigError("max_depth", self.max_depth, f"more than min_depth {self.min_depth}")
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
