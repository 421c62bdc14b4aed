"""Fit of the noise models to pairs with true disparity (``infomap calibrate-noise``).

The power law of `noise.sigma_from_quality` is fitted by maximum likelihood of a Student
distribution with 4 degrees of freedom (matching errors have heavier tails than a Gaussian and
must not blow up sigma), all pairs with equal weight, the variance of the truth itself added.
From there the worst misfit of any pair's shares of errors within 1, 2 and 3 sigma to a Gaussian's
is minimized together with the loss of log-likelihood. Each scene is also predicted by a fit
without it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.optimize import minimize

from infomap_ros.errors import InvalidInputError
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.stereo.config import StereoConfig
from infomap_ros.stereo.evaluation import (
    GAUSSIAN_SHARES,
    PairErrors,
    StereoPair,
    measure_errors,
    shares_within,
)
from infomap_ros.stereo.noise import MatchTerms, sigma_from_terms

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


_STUDENT_DEGREES = 4.0
_SAMPLES = 80_000
# Pulls the exponents towards zero where the data do not ask for them; far below one sample's say.
_RIDGE = 1e-3
# A loss of 0.1 in log-likelihood is worth a misfit of 2 points.
_LOSS_WEIGHT = 0.2
Shares = tuple[float, float, float]


@dataclass(frozen=True, eq=False)
class PairReport:
    """How the fit does on one pair.

    Attributes:
        errors: what was measured on the pair.
        shares: of the inliers within 1, 2, 3 sigma by this fit, the variance of the truth added.
        raw_shares: the same without the variance of the truth.
        predicted_shares: as `shares`, by a fit without this scene; None if it was the only one.
        error_correlation: mean correlation of errors 5 to 15 px apart.
    """

    errors: PairErrors
    shares: Shares
    raw_shares: Shares
    predicted_shares: Shares | None
    error_correlation: float


@dataclass(frozen=True, eq=False)
class NoiseFit:
    """Calibrated noise models.

    Attributes:
        config: the given parameters with the fitted noise models.
        printed: fit of eq. (1).
        reports: one per pair.
    """

    config: StereoConfig
    printed: PrintedFit
    reports: tuple[PairReport, ...]

    def table(self) -> str:
        """The honesty table, in Markdown."""
        head = "| pair | density | bad > 3 px | plain bad (density) | within 1, 2, 3 sigma | "
        head += "truth taken as exact | fitted without the scene | error correlation |"
        rows = [head, "|" + " --- |" * 8, *(_table_row(report) for report in self.reports)]
        return "\n".join(rows)

    def summary(self) -> dict[str, float]:
        """Fitted parameters by the names of `StereoConfig`, tuples spread as name_0, name_1."""
        numbers: dict[str, float] = {}
        for name in _FITTED:
            value = getattr(self.config, name)
            values = value if isinstance(value, tuple) else (value,)
            keys = [f"{name}_{i}" for i in range(len(values))] if len(values) > 1 else [name]
            numbers.update(zip(keys, values, strict=True))
        return numbers


_FITTED = (
    "sigma_scale",
    "sigma_residual_power",
    "sigma_texture_power",
    "error_correlation",
    "printed_s",
    "printed_t",
    "printed_n",
)


def calibrate_noise(
    pairs: Sequence[StereoPair], config: StereoConfig | None = None, *, half_sizes: bool = True
) -> NoiseFit:
    """Fit both noise models to pairs with truth.

    Args:
        pairs: at least one pair.
        config: matcher and filters to calibrate for; defaults where None.
        half_sizes: fit to every pair at half size too, so that the fit holds over resolutions.

    Raises:
        InvalidInputError: no pair, or a pair on which nearly nothing was measured.
    """
    if not pairs:
        raise InvalidInputError("pairs", "no stereo pair with true disparity was given")
    config = config or StereoConfig()
    sizes = [*pairs, *(pair.halved() for pair in pairs if half_sizes)]
    errors = [measure_errors(pair, config) for pair in sizes]
    samples = [_Samples.of(one) for one in errors]
    printed = fit_printed(errors[: len(pairs)])
    correlations = [one.error_correlation() for one in errors]
    fitted = replace(
        _fit_power_law(samples, config),
        error_correlation=round(float(np.mean(correlations)), 2),
        printed_s=printed.s,
        printed_t=printed.t,
        printed_n=printed.n,
    )
    scenes = [pair.scene or pair.name for pair in sizes]
    reports = []
    for one, sample, scene in zip(errors, samples, scenes, strict=True):
        others = [s for s, other in zip(samples, scenes, strict=True) if other != scene]
        without = _fit_power_law(others, config) if others else None
        reports.append(_report(one, sample, fitted, without))
    return NoiseFit(fitted, printed, tuple(reports))


def _report(
    errors: PairErrors, sample: _Samples, fitted: StereoConfig, without: StereoConfig | None
) -> PairReport:
    sigma = sigma_from_terms(errors.terms, fitted).astype(np.float32)
    return PairReport(
        replace(errors, sigma=np.where(errors.kept, sigma, np.float32(np.nan))),
        sample.shares(fitted),
        sample.shares(fitted, truth_sigma=0.0),
        sample.shares(without) if without else None,
        errors.error_correlation(),
    )


@dataclass(frozen=True, eq=False)
class _Samples:
    """Errors [px] and variance terms of one pair's inliers, shape (N,) each."""

    error: FloatArray
    terms: MatchTerms
    truth_sigma: float

    @cached_property
    def design(self) -> FloatArray:
        """Design matrix of the logarithm of the matching sigma, shape (N, 3)."""
        return np.column_stack([np.ones(self.error.size), self.terms.residual, self.terms.width])

    @staticmethod
    def of(errors: PairErrors) -> _Samples:
        pixels = np.flatnonzero(errors.inliers)
        if len(pixels) < 1000:
            name = errors.pair.name
            raise InvalidInputError(name, f"only {len(pixels)} pixels were measured right")
        chosen = np.random.default_rng(0).permutation(pixels)[:_SAMPLES]
        terms = MatchTerms(*(term.ravel()[chosen] for term in errors.terms))
        return _Samples(
            errors.error.ravel()[chosen].astype(np.float64), terms, errors.pair.truth_sigma
        )

    def sigma(self, config: StereoConfig) -> FloatArray:
        """Sigma by the power law of `config`, shape (N,) [px]."""
        return np.asarray(sigma_from_terms(self.terms, config))

    def shares(self, config: StereoConfig, truth_sigma: float | None = None) -> Shares:
        extra = self.truth_sigma if truth_sigma is None else truth_sigma
        return shares_within(self.error, np.hypot(self.sigma(config), extra))


def _fit_power_law(samples: Sequence[_Samples], config: StereoConfig) -> StereoConfig:
    start = np.array([np.log(0.1), 0.5, 0.5])
    bounds = [(-6.0, 4.0), (0.0, 3.0), (0.0, 3.0)]
    likely = minimize(
        _negative_log_likelihood, start, (samples,), "L-BFGS-B", jac=True, bounds=bounds
    )

    def objective(powers: FloatArray) -> float:
        loss = _negative_log_likelihood(powers, samples)[0] - float(likely.fun)
        return _LOSS_WEIGHT * loss + max(
            _misfit(one, _with_powers(config, powers)) for one in samples
        )

    options = {"maxfev": 400, "xatol": 1e-3, "fatol": 1e-5, "initial_simplex": _simplex(likely.x)}
    honest = minimize(objective, likely.x, method="Nelder-Mead", bounds=bounds, options=options)
    return _with_powers(config, honest.x, digits=3)


def _simplex(powers: FloatArray) -> FloatArray:
    """First steps of the search: 20 % of sigma, 0.1 of the exponents."""
    return np.vstack([powers, powers + np.diag([0.2, 0.1, 0.1])])


def _with_powers(config: StereoConfig, powers: FloatArray, digits: int = 12) -> StereoConfig:
    scale, residual, texture = powers
    return replace(
        config,
        sigma_scale=round(float(np.exp(scale)), digits),
        sigma_residual_power=round(float(residual), digits),
        sigma_texture_power=round(float(texture), digits),
    )


def _misfit(samples: _Samples, config: StereoConfig) -> float:
    """Largest distance of the three shares from a Gaussian's."""
    found = samples.shares(config)
    return max(abs(a - b) for a, b in zip(found, GAUSSIAN_SHARES, strict=True))


def _negative_log_likelihood(
    powers: FloatArray, samples: Sequence[_Samples]
) -> tuple[float, FloatArray]:
    """Mean over the pairs of the mean over their errors, and its gradient."""
    nu = _STUDENT_DEGREES
    penalised = np.r_[0.0, powers[1:]]
    value, slope = _RIDGE * float(penalised @ penalised), 2.0 * _RIDGE * penalised
    for one in samples:
        own = np.exp(2.0 * (one.design @ powers))
        variance = own + one.terms.photometric + one.truth_sigma**2
        ratio = one.error**2 / (variance * nu)
        value += float(np.mean(0.5 * np.log(variance) + 0.5 * (nu + 1.0) * np.log1p(ratio))) / len(
            samples
        )
        by_variance = (0.5 - 0.5 * (nu + 1.0) * ratio / (1.0 + ratio)) / variance
        slope = slope + one.design.T @ (2.0 * own * by_variance) / one.error.size / len(samples)
    return value, slope


def _table_row(report: PairReport) -> str:
    errors = report.errors
    triples = [report.shares, report.raw_shares, report.predicted_shares]
    shares = [" / ".join(f"{100 * s:.1f}" for s in triple) if triple else "-" for triple in triples]
    plain = f"{100 * errors.plain_bad:.2f} % ({100 * errors.plain_density:.1f} %)"
    cells = [
        errors.pair.name,
        f"{100 * errors.density:.1f} %",
        f"{100 * errors.bad:.2f} %",
        plain,
        *shares,
        f"{report.error_correlation:.2f}",
    ]
    return "| " + " | ".join(cells) + " |"
