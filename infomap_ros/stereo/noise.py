"""Noise models: what a disparity is worth, and the 3-D Gaussian of a range point.

Disparity model. The variance of a disparity is that which image noise alone leaves (Cramer-Rao
bound) plus that of matching, a power law of the photometric residual and of the width of the
texture (see `sigma_from_quality`). With
``D = d + principal_offset`` (zero at infinity), ``z = f B / D`` and ``r = sigma_d / D`` the range
statistics are taken to second order, because a first-order covariance is biased and too small at
long range (Sibley, Matthies, Sukhatme, ISRR 2005):

    E[f B / (D + e)] = z (1 + r^2 + ...),  so z_hat = (f B / D) (1 - r^2)
    Var[z_hat] = z^2 r^2 (1 + 2 r^2 + ...)

Pixels with r above max_relative_sigma are dropped, which bounds what is left of the bias to
3 r^4 of the depth.

Printed model. Equations (1)-(3) of Sujan and Dubowsky 2005: standard deviations
``S T_{x,y,z} L^n`` along the camera axes, L the distance to the point, with constant
correlations. S is an intrinsic constant of the camera; here it is a disparity error over
``f B``, so that one number serves any rig. Equation (3) is the rotation ``R C R^T`` that takes
the covariance to another frame (the printed transposes depend on the sign of theta).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from infomap_ros.geometry import StereoRig
from infomap_ros.stereo.config import StereoConfig
from infomap_ros.stereo.images import RowBands
from infomap_ros.stereo.quality import REFINEMENT_WINDOW, SMOOTHING_WINDOW, MatchQuality

# Added to the squared residual, gradient and curvature so that the power law stays finite:
# quantization and read noise of an 8-bit image [gray levels^2].
_RESIDUAL_NOISE = 0.1
_GRADIENT_NOISE = 0.1
_CURVATURE_NOISE = 0.5
# Independent noise in both images, whose difference has the residual's variance R, adds R / 8 to
# the squared gradient (mean of the two central differences) and 3 R to the squared second
# derivative of the left image. It is taken out, but never more than three quarters, as the
# residual holds more than noise.
_NOISE_IN_GRADIENT = 0.125
_NOISE_IN_CURVATURE = 3.0
_LEAST_SIGNAL = 0.25
# Pixels whose photometric differences take part in one refined, smoothed disparity.
_SAMPLES = (REFINEMENT_WINDOW + SMOOTHING_WINDOW - 1) ** 2
_SIGMA_FLOOR = 0.05  # of the disparity [px]
# Largest sigma as a share of the disparity from infinity: beyond it the second-order range
# statistics are not trustworthy.
_MAX_RELATIVE_SIGMA = 0.15


class MatchTerms(NamedTuple):
    """What the variance of a disparity is made of; planes of equal shape.

    Attributes:
        residual: natural logarithm of the rms photometric residual [gray levels].
        width: natural logarithm of the width of the texture [px]: rms first over rms second
            derivative. Wider texture, as in a blurred or enlarged image, locates a match less.
        photometric: Cramer-Rao bound of the disparity from image noise [px^2]: the residual over
            the sum of squared gradients of the pixels that refinement and smoothing use.
    """

    residual: NDArray[np.float64]
    width: NDArray[np.float64]
    photometric: NDArray[np.float64]


def match_terms(quality: MatchQuality) -> MatchTerms:
    """Terms of `sigma_from_quality`, for its calibration; shape (H, W) each."""
    residual = quality.residual.astype(np.float64) + _RESIDUAL_NOISE
    gradient = quality.gradient.astype(np.float64) + _GRADIENT_NOISE
    curvature = quality.curvature.astype(np.float64) + _CURVATURE_NOISE
    slope = np.maximum(gradient - _NOISE_IN_GRADIENT * residual, _LEAST_SIGNAL * gradient)
    bend = np.maximum(curvature - _NOISE_IN_CURVATURE * residual, _LEAST_SIGNAL * curvature)
    bound = residual / (_SAMPLES * slope)
    return MatchTerms(0.5 * np.log(residual), 0.5 * np.log(slope / bend), np.asarray(bound))


def sigma_from_terms(terms: MatchTerms, config: StereoConfig) -> NDArray[np.float64]:
    """`sigma_from_quality`, exactly, from its terms; same shape [px]."""
    exponent = config.sigma_residual_power * terms.residual
    exponent = exponent + config.sigma_texture_power * terms.width
    sigma = np.sqrt((config.sigma_scale * np.exp(exponent)) ** 2 + terms.photometric)
    return np.asarray(np.maximum(sigma, _SIGMA_FLOOR))


def sigma_from_quality(
    quality: MatchQuality, config: StereoConfig, bands: RowBands
) -> NDArray[np.float32]:
    """Standard deviation of refined disparities, shape (H, W), float32 [px].

    ``sigma^2 = (scale * residual^a * width^c)^2 + bound``, at least `_SIGMA_FLOOR` squared, with
    the terms of `MatchTerms`. Within 1 % (the logarithms are approximated).

    Args:
        quality: of the matches.
        config: the noise model's parameters.
        bands: threads to work in.
    """
    powers = np.array([0.5 * config.sigma_residual_power, 0.5 * config.sigma_texture_power])
    numbers = np.array([config.sigma_scale, _SIGMA_FLOOR, _SAMPLES])
    sigma = np.empty(quality.disparity.shape, np.float32)
    arguments = (powers.astype(np.float32), numbers.astype(np.float32))

    def work(first: int, end: int) -> None:
        planes = (plane[first:end].ravel() for plane in quality[1:])
        _sigma_kernel(*planes, *arguments, sigma[first:end].ravel())

    bands.run(work)
    return sigma


@njit(nogil=True, cache=True, error_model="numpy")
def _sigma_kernel(residual, gradient, curvature, powers, numbers, sigma):  # type: ignore[no-untyped-def]
    residual_power, width_power = powers
    scale, floor, samples = numbers
    least = np.float32(_LEAST_SIGNAL)
    for i in range(sigma.size):
        r = residual[i] + np.float32(_RESIDUAL_NOISE)
        g = gradient[i] + np.float32(_GRADIENT_NOISE)
        h = curvature[i] + np.float32(_CURVATURE_NOISE)
        slope = max(g - np.float32(_NOISE_IN_GRADIENT) * r, least * g)
        bend = max(h - np.float32(_NOISE_IN_CURVATURE) * r, least * h)
        matching = scale * _exp2(residual_power * _log2(r) + width_power * _log2(slope / bend))
        sigma[i] = max(np.sqrt(matching * matching + r / (samples * slope)), floor)


@njit(nogil=True, cache=True, inline="always", error_model="numpy")
def _log2(x):  # type: ignore[no-untyped-def]
    """Base-2 logarithm of a positive float32 within 0.005: exponent bits plus a parabola."""
    bits = np.float32(x).view(np.int32)
    mantissa = np.int32((bits & 0x7FFFFF) | 0x3F800000).view(np.float32)
    curve = (np.float32(-0.34484843) * mantissa + np.float32(2.02466578)) * mantissa
    return np.float32((bits >> 23) - 127) + curve + np.float32(-1.67487759)


@njit(nogil=True, cache=True, inline="always", error_model="numpy")
def _exp2(x):  # type: ignore[no-untyped-def]
    """Two to the power of a float32 between -120 and 120, within 0.3 %."""
    whole = np.floor(x)
    f = np.float32(x) - np.float32(whole)
    bits = np.int32((np.int32(whole) + 127) << 23)
    curve = (np.float32(0.33718944) * f + np.float32(0.65763628)) * f + np.float32(1.0017247)
    return bits.view(np.float32) * curve


class StereoRange(NamedTuple):
    """Range image with its noise, all of shape (H, W), float32, NaN where dropped.

    Attributes:
        depth: z without the second-order bias [m].
        variance: variance of depth [m^2].
        disparity: [px].
        disparity_sigma: standard deviation of disparity [px].
    """

    depth: NDArray[np.float32]
    variance: NDArray[np.float32]
    disparity: NDArray[np.float32]
    disparity_sigma: NDArray[np.float32]


def range_from_disparity(
    rig: StereoRig,
    config: StereoConfig,
    keep: NDArray[np.bool_],
    disparity: NDArray[np.float32],
    sigma: NDArray[np.float32],
    bands: RowBands,
) -> StereoRange:
    """Depth and its variance to second order (see the module's head).

    Args:
        rig: rectified pair.
        config: min_depth and max_depth.
        keep: pixels to convert, shape (H, W).
        disparity: shape (H, W) [px].
        sigma: standard deviation of disparity, shape (H, W) [px].
        bands: threads to work in.
    """
    result = StereoRange(*(np.empty(disparity.shape, np.float32) for _ in range(4)))
    focal_baseline, offset = rig.left.fx * rig.baseline, rig.principal_offset
    limits = (config.min_depth, config.max_depth, _MAX_RELATIVE_SIGMA)
    numbers = np.array([focal_baseline, offset, *limits], np.float32)

    def work(first: int, end: int) -> None:
        inputs = (plane[first:end] for plane in (keep, disparity, sigma))
        _convert(*inputs, numbers, *(plane[first:end] for plane in result))

    bands.run(work)
    return result


@njit(nogil=True, cache=True, error_model="numpy")
def _convert(  # type: ignore[no-untyped-def]
    keep, disparity, sigma, numbers, depth, variance, kept, kept_sigma
):
    focal_baseline, offset, nearest, farthest, largest_ratio = numbers
    nan = np.float32(np.nan)
    height, width = disparity.shape
    for v in range(height):
        for u in range(width):
            shifted = disparity[v, u] + offset
            ratio = sigma[v, u] / shifted
            square = ratio * ratio
            z = focal_baseline / shifted * (np.float32(1.0) - square)
            good = keep[v, u] and shifted > 0.0 and ratio <= largest_ratio
            good = good and nearest <= z <= farthest
            depth[v, u] = z if good else nan
            variance[v, u] = z * z * square * (np.float32(1.0) + np.float32(2.0) * square)
            kept[v, u] = disparity[v, u] if good else nan
            kept_sigma[v, u] = sigma[v, u] if good else nan
