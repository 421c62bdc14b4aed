"""Figures of an exploration, and their means over worlds with confidence bands."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import stats

from infomap_ros.geometry.transforms import FloatArray

CONFIDENCE = 0.95
"""Of all bands."""


def fraction_at(distance: FloatArray, fraction: FloatArray, at: FloatArray) -> FloatArray:
    """Fraction mapped when the sensor has moved so far: that of the last scan before.

    Args:
        distance: moved until each scan, ascending, shape (K,) [m].
        fraction: mapped after each scan, shape (K,).
        at: distances, shape (N,) [m]; beyond the last scan its fraction stays.

    Returns:
        Shape (N,).
    """
    last = np.searchsorted(distance, at, side="right") - 1
    return np.asarray(np.where(last >= 0, fraction[np.maximum(last, 0)], 0.0))


def area_under_coverage(distance: FloatArray, fraction: FloatArray, reach: float) -> float:
    """Mean fraction mapped over the first `reach` metres, in [0, 1]; see `fraction_at`."""
    edges = np.concatenate([distance[distance < reach], [reach]])
    steps = np.diff(edges)
    return float(fraction[: len(steps)] @ steps / reach)


def distance_to(distance: FloatArray, fraction: FloatArray, share: float) -> float:
    """Distance moved when that share was first mapped [m]; inf if it never was."""
    reached = np.flatnonzero(fraction >= share)
    return float(distance[reached[0]]) if len(reached) else float("inf")


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


def band(values: FloatArray) -> Band:
    """Mean of one value per world, shape (n,), with its band; NaN where there is none."""
    count = len(values)
    if count < 2:
        return Band(float(values[0]) if count else float("nan"), float("nan"), count)
    quantile = float(stats.t.ppf(0.5 + 0.5 * CONFIDENCE, count - 1))
    return Band(float(values.mean()), quantile * float(stats.sem(values)), count)


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


def savings(own: FloatArray, others: FloatArray) -> FloatArray:
    """Share of the distance that one strategy saves against another, per world, shape (n,)."""
    return np.asarray(1.0 - own / others)
