"""Means over worlds with confidence bands."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import stats

from infomap_ros.geometry.transforms import FloatArray

CONFIDENCE = 0.95
"""Of all bands."""


@dataclass(frozen=True)
class Band:
    """A mean over worlds with the half width of its confidence band.

    Attributes:
        mean: over the worlds.
        half: by Student's t; NaN for a single world.
        count: of worlds.
    """

    mean: float
    half: float
    count: int

    def __str__(self) -> str:
        return f"{self.mean:.3g} ± {self.half:.2g}" if self.count > 1 else f"{self.mean:.3g}"

    def text(self, factor: float = 1.0, digits: int = 0) -> str:
        """For tables: mean and half width times a factor, "-" where there is no value.

        Args:
            factor: 100 for per cent.
            digits: after the point.
        """
        if not self.count:
            return "-"
        mean = f"{factor * self.mean:.{digits}f}"
        return mean if self.count < 2 else f"{mean} ± {factor * self.half:.{digits}f}"


def band(values: FloatArray) -> Band:
    """Mean of one value per world, shape (n,), with its band; NaN where there is none."""
    count = len(values)
    if count < 2:
        return Band(float(values[0]) if count else float("nan"), float("nan"), count)
    mean, half = curve_band(values[:, None])
    return Band(float(mean[0]), float(half[0]), count)


def ratio_band(own: FloatArray, other: FloatArray) -> Band:
    """Geometric mean of ratios, paired over worlds, shape (n,) each, positive.

    The band is that of the mean logarithm; of its two half widths, which differ, the larger.
    """
    logarithms = band(np.log(own / other))
    mean = float(np.exp(logarithms.mean))
    return Band(mean, mean * float(np.expm1(logarithms.half)), logarithms.count)


def curve_band(curves: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Mean and half width of the band of curves, shape (worlds, N) -> (N,) each.

    The half width is 0 for a single world.
    """
    count = len(curves)
    mean = curves.mean(axis=0)
    if count < 2:
        return mean, np.zeros_like(mean)
    quantile = float(stats.t.ppf(0.5 + 0.5 * CONFIDENCE, count - 1))
    return mean, np.asarray(quantile * stats.sem(curves, axis=0))
