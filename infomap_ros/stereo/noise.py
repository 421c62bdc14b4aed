"""Noise models: what a disparity is worth, and the 3-D Gaussian of a range point.

Disparity model. The standard deviation of a disparity is a power law of what the match rests
on: photometric residual, gradient, and width of the texture (see `sigma_from_quality`). With
``D = d + principal_offset`` (zero at infinity), ``z = f B / D`` and ``r = sigma_d / D`` the range
statistics are taken to second order, because a first-order covariance is biased and too small at
long range (Sibley, Matthies, Sukhatme 2005, DOI 10.1109/IROS.2005.1545270):

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
from infomap_ros.stereo.bands import RowBands
from infomap_ros.stereo.config import StereoConfig
from infomap_ros.stereo.quality import MatchQuality

# Added to the squared residual, gradient and curvature so that the power law stays finite:
# quantisation and read noise of an 8-bit image [grey levels^2].
_RESIDUAL_NOISE = 0.1
_GRADIENT_NOISE = 0.1
_CURVATURE_NOISE = 0.5


def quality_logarithms(quality: MatchQuality) -> NDArray[np.float64]:
    """Natural logarithms of residual, gradient and texture width, shape (3, H, W).

    All three are rms values over the window. The texture width is the rms first over the rms
    second derivative [px]: wider texture, as in a blurred or enlarged image, locates a match
    less well.
    """
    residual = 0.5 * np.log(quality.residual + _RESIDUAL_NOISE, dtype=np.float64)
    gradient = 0.5 * np.log(quality.gradient + _GRADIENT_NOISE, dtype=np.float64)
    curvature = 0.5 * np.log(quality.curvature + _CURVATURE_NOISE, dtype=np.float64)
    return np.stack([residual, gradient, gradient - curvature])


def sigma_from_logarithms(
    logarithms: NDArray[np.float64], config: StereoConfig
) -> NDArray[np.float64]:
    """The power law of `sigma_from_quality` on `quality_logarithms`, exactly.

    Args:
        logarithms: shape (3, ...).
        config: powers, sigma_scale and sigma_floor.

    Returns:
        Standard deviation of the disparity, shape (...) [px].
    """
    residual, gradient, width = logarithms
    exponent = config.sigma_residual_power * residual + config.sigma_gradient_power * gradient
    exponent += config.sigma_texture_power * width
    return np.asarray(np.maximum(config.sigma_scale * np.exp(exponent), config.sigma_floor))


def sigma_from_quality(quality: MatchQuality, config: StereoConfig) -> NDArray[np.float32]:
    """Standard deviation of refined disparities, shape (H, W), float32 [px].

    ``sigma = scale * residual^a * gradient^b * width^c``, at least sigma_floor, with the rms
    photometric residual and gradient of the window in grey levels and the width in px, see
    `quality_logarithms`. Within 1 % (the logarithms are approximated).
    """
    a, b, c = (
        config.sigma_residual_power,
        config.sigma_gradient_power,
        config.sigma_texture_power,
    )
    powers = np.array([0.5 * a, 0.5 * (b + c), -0.5 * c], np.float32)
    sigma = np.empty(quality.disparity.shape, np.float32)
    planes = [plane.ravel() for plane in quality[1:]]
    scale, floor = np.float32(config.sigma_scale), np.float32(config.sigma_floor)
    _sigma_kernel(*planes, powers, scale, floor, sigma.ravel())
    return sigma


@njit(nogil=True, cache=True, error_model="numpy")
def _sigma_kernel(  # type: ignore[no-untyped-def]
    residual, gradient, curvature, powers, scale, floor, sigma
):
    power_r, power_g, power_c = powers[0], powers[1], powers[2]
    for i in range(sigma.size):
        exponent = power_r * _log2(residual[i] + np.float32(_RESIDUAL_NOISE))
        exponent += power_g * _log2(gradient[i] + np.float32(_GRADIENT_NOISE))
        exponent += power_c * _log2(curvature[i] + np.float32(_CURVATURE_NOISE))
        sigma[i] = max(scale * _exp2(exponent), floor)


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
        config: min_depth, max_depth and max_relative_sigma.
        keep: pixels to convert, shape (H, W).
        disparity: shape (H, W) [px].
        sigma: standard deviation of disparity, shape (H, W) [px].
        bands: threads to work in.
    """
    result = StereoRange(*(np.empty(disparity.shape, np.float32) for _ in range(4)))
    focal_baseline, offset = rig.left.fx * rig.baseline, rig.principal_offset
    limits = (config.min_depth, config.max_depth, config.max_relative_sigma)
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
