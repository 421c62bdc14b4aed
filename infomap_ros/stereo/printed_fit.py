"""Fit of eq. (1), ``sigma_{x,y,z} = S T_{x,y,z} L^n``, to pairs with truth."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.stereo.evaluation import GAUSSIAN_SHARES, PairErrors

_BINS = 8


@dataclass(frozen=True, eq=False)
class PrintedFit:
    """Constants of eq. (1) and what they were fitted to.

    Attributes:
        s: S as a disparity error [px]; S of the paper is this over f B.
        t: T_x, T_y, T_z, with T_z = 1.
        n: exponent of the distance.
        names: of the pairs.
        distances: centers of the distance bins of every pair, shape (pairs, bins) [m].
        sigmas: 68 % quantile of the depth error in every bin times f B, shape (pairs, bins).
    """

    s: float
    t: tuple[float, float, float]
    n: float
    names: tuple[str, ...]
    distances: FloatArray
    sigmas: FloatArray


def fit_printed(errors: Sequence[PairErrors]) -> PrintedFit:
    """Fit S, T and n to the depth errors of the inliers.

    n is the common slope of the logarithm of the depth error over that of the distance within the
    pairs; S is common, T_x and T_y are medians over the pairs of the lateral over the depth error.

    Args:
        errors: one per pair.
    """
    points = [_points(one) for one in errors]
    binned = [_bins(distance, error[:, 2]) for distance, error in points]
    distances = np.array([one[0] for one in binned])
    sigmas = np.array([one[1] for one in binned])
    x, y = np.log(distances), np.log(sigmas)
    centered_x, centered_y = (a - a.mean(axis=1, keepdims=True) for a in (x, y))
    n = float(np.clip((centered_x * centered_y).sum() / (centered_x**2).sum(), 0.5, 4.0))
    s = float(np.exp((y - n * x).mean()))
    lateral = np.median(
        [[_sigma68(error[:, i]) / _sigma68(error[:, 2]) for i in (0, 1)] for _, error in points],
        axis=0,
    )
    t = (round(float(lateral[0]), 3), round(float(lateral[1]), 3), 1.0)
    names = tuple(one.pair.name for one in errors)
    return PrintedFit(round(s, 3), t, round(n, 2), names, distances, sigmas)


def _points(errors: PairErrors) -> tuple[FloatArray, FloatArray]:
    """True distances, shape (N,) [m], and errors of x, y, z times f B, shape (N, 3)."""
    rig, truth = errors.pair.rig, errors.pair.truth
    inliers = errors.inliers & np.isfinite(rig.depth_from_disparity(truth))
    true = rig.depth_from_disparity(truth)[inliers]
    measured = rig.depth_from_disparity(truth + errors.error)[inliers]
    v, u = np.nonzero(inliers)
    camera = rig.left
    ray = np.column_stack(
        [(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, np.ones(len(u))]
    )
    distance = true * np.linalg.norm(ray, axis=1)
    scale = camera.fx * rig.baseline
    return distance, ray * (measured - true)[:, None] * scale


def _bins(distance: FloatArray, error: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Median distance and 68 % error in bins of equal width that hold enough points."""
    edges = np.quantile(distance, np.linspace(0.0, 1.0, _BINS + 1))
    index = np.clip(np.searchsorted(edges, distance) - 1, 0, _BINS - 1)
    groups = [(distance[index == i], error[index == i]) for i in range(_BINS)]
    centers = np.array([np.median(d) for d, _ in groups])
    return centers, np.array([max(_sigma68(e), 1e-12) for _, e in groups])


def _sigma68(error: FloatArray) -> float:
    return float(np.quantile(np.abs(error), GAUSSIAN_SHARES[0]))
