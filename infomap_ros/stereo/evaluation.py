"""How far predicted disparity sigmas can be trusted, against true disparities."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.stereo.config import StereoConfig
from infomap_ros.stereo.ground_truth import StereoPair
from infomap_ros.stereo.images import gray
from infomap_ros.stereo.matching import SUBPIXELS, DisparityMatcher, disparity_range
from infomap_ros.stereo.noise import MatchTerms, match_terms
from infomap_ros.stereo.sensor import StereoRangeSensor

#: Larger disparity errors are mismatches (bad pixels), which no sigma describes [px].
INLIER_LIMIT = 3.0
#: Shares of a Gaussian within 1, 2 and 3 standard deviations.
GAUSSIAN_SHARES = (0.6827, 0.9545, 0.9973)
_SHIFTS = ((5, 0), (0, 5), (6, 6), (6, -6), (10, 0), (0, 10), (9, 9), (9, -9), (15, 0), (0, 15))


@dataclass(frozen=True, eq=False)
class PairErrors:
    """Disparity errors of the kept pixels of one pair.

    Attributes:
        pair: the pair.
        kept: pixels that the sensor kept and that have a truth, shape (H, W).
        error: measured minus true disparity, shape (H, W) [px]; NaN where not kept.
        sigma: predicted standard deviation, shape (H, W) [px]; NaN where not kept.
        terms: of the variance of the disparity, shape (H, W) each.
        density: kept pixels per pixel with a truth.
        plain_bad: share of errors above 3 px of the same matcher without filters.
        plain_density: of the same.
    """

    pair: StereoPair
    kept: NDArray[np.bool_]
    error: NDArray[np.float32]
    sigma: NDArray[np.float32]
    terms: MatchTerms
    density: float
    plain_bad: float
    plain_density: float

    @property
    def inliers(self) -> NDArray[np.bool_]:
        """Kept pixels with an error of at most 3 px, shape (H, W)."""
        return self.kept & (np.abs(self.error) <= INLIER_LIMIT)

    @property
    def bad(self) -> float:
        """Share of kept pixels with an error above 3 px."""
        return 1.0 - float(self.inliers.sum() / max(self.kept.sum(), 1))

    def shares(self, with_truth_sigma: bool = True) -> tuple[float, float, float]:
        """Shares of the inliers within 1, 2 and 3 predicted standard deviations.

        Args:
            with_truth_sigma: add the variance of the truth itself to the predicted one.
        """
        extra = self.pair.truth_sigma if with_truth_sigma else 0.0
        inliers = self.inliers
        return shares_within(self.error[inliers], np.hypot(self.sigma[inliers], extra))

    def error_correlation(self) -> float:
        """Mean correlation of the errors of two inliers 5 to 15 px apart.

        Not centered: an offset that neighbors share is correlation. The variance of the truth is
        taken out of the denominator, as it is hardly shared.
        """
        error = np.where(self.inliers, self.error, np.nan).astype(np.float64)
        products = [_shifted_product(error, *shift) for shift in _SHIFTS]
        variance = float(np.nanmean(error**2)) - self.pair.truth_sigma**2
        return float(np.clip(np.mean(products) / max(variance, 1e-12), 0.0, 1.0))


def shares_within(
    error: NDArray[np.floating], sigma: NDArray[np.floating]
) -> tuple[float, float, float]:
    """Shares of errors within 1, 2 and 3 sigma; both of shape (N,)."""
    ratio = np.abs(error) / sigma
    one, two, three = (float(np.mean(ratio <= k)) for k in (1, 2, 3))
    return one, two, three


def _shifted_product(error: FloatArray, right: int, down: int) -> float:
    height, width = error.shape
    rows = slice(max(0, down), height + min(0, down))
    other_rows = slice(max(0, -down), height + min(0, -down))
    here, there = error[rows, right:], error[other_rows, : width - right]
    return float(np.nanmean(here * there))


def measure_errors(pair: StereoPair, config: StereoConfig) -> PairErrors:
    """Run the sensor and the plain matcher on a pair with truth.

    Args:
        pair: images, rig and truth.
        config: parameters; its depth range is replaced by the scene's.
    """
    config = pair.search(config)
    sensor = StereoRangeSensor(pair.rig, config)
    left, right = gray(pair.left), gray(pair.right)
    cloud = sensor.measure(pair.left, pair.right)
    _, quality = sensor.assess(left, right, sensor.match(left, right))
    assert cloud.disparity is not None and cloud.disparity_sigma is not None
    known = np.isfinite(pair.truth)
    kept = cloud.valid & known
    plain_bad, plain_density = _plain(pair, config)
    return PairErrors(
        pair,
        kept,
        np.where(kept, cloud.disparity - pair.truth, np.float32(np.nan)),
        np.where(kept, cloud.disparity_sigma, np.float32(np.nan)),
        match_terms(quality, config),
        float(kept.sum() / known.sum()),
        plain_bad,
        plain_density,
    )


def _plain(pair: StereoPair, config: StereoConfig) -> tuple[float, float]:
    """Bad share and density of the matcher with its filters off.

    OpenCV's own left-right check of 1 px cannot be switched off by its documented parameters, so
    it stays on, and the comparison is the stricter one.
    """
    plain = replace(config, uniqueness=0, left_right_tolerance=1)
    matcher = DisparityMatcher(disparity_range(pair.rig, plain), plain)
    disparity = matcher.match(gray(pair.left), gray(pair.right))
    known = np.isfinite(pair.truth)
    found = known & (disparity > matcher.invalid)
    error = disparity[found] / SUBPIXELS - pair.truth[found]
    return float(np.mean(np.abs(error) > INLIER_LIMIT)), float(found.sum() / known.sum())
