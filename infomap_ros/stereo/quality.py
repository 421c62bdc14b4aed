"""Sub-pixel refinement of a disparity image and the quality of every match.

One Gauss-Newton step on the photometric error of a window moves each disparity to where the
images agree best (Lucas and Kanade 1981; the semi-global matcher interpolates a cost that is
blind within half a pixel, so its fractions pile up at whole numbers). The same window sums tell
how well a match is determined: residual, gradient and width of the texture.
"""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np
from numba import njit
from numpy.typing import NDArray

from infomap_ros.geometry.kernel import kernel
from infomap_ros.stereo.config import StereoConfig
from infomap_ros.stereo.images import RowBands
from infomap_ros.stereo.matching import SUBPIXELS

# Keeps the step small where the gradient is at the level of image noise [gray levels^2].
_GRADIENT_NOISE = 5.0
# Largest correction of a disparity [px]; the matcher is right to the whole pixel or wrong.
_LARGEST_STEP = 0.5
REFINEMENT_WINDOW = 7
"""Side of the window of the photometric sub-pixel step and of the matching quality, odd [px]."""
SMOOTHING_WINDOW = 5
"""Refined disparities are averaged over this window, odd [px]; a larger one than that of the edges
would average over holes."""
# Mean squared horizontal gradient over the photometric variance that the match leaves unexplained;
# images of nothing but sensor noise, as of the sky, have 0.2.
_MIN_CONTRAST = np.float32(0.35)
# Window sums: count, g, e, gg, ge, ee, hh with gradient g, difference e, second derivative h.
_CHANNELS = 7


class MatchQuality(NamedTuple):
    """Refined disparity and what it rests on, all of shape (H, W), float32.

    Attributes:
        disparity: refined disparity [px]; meaningless where there was no match.
        residual: variance of the photometric difference in the window that the refinement does
            not explain [gray levels^2].
        gradient: mean squared horizontal gradient in the window [(gray levels/px)^2].
        curvature: mean squared second horizontal derivative [(gray levels/px^2)^2].
    """

    disparity: NDArray[np.float32]
    residual: NDArray[np.float32]
    gradient: NDArray[np.float32]
    curvature: NDArray[np.float32]


def refine(
    left: NDArray[np.uint8],
    right: NDArray[np.uint8],
    disparity: NDArray[np.int16],
    invalid: int,
    window: int,
    smoothing: int,
    bands: RowBands,
) -> MatchQuality:
    """Refine a disparity image and measure the quality of its matches.

    Args:
        left: gray image, shape (H, W).
        right: gray image, shape (H, W).
        disparity: of the left pixels, shape (H, W) [1/16 px].
        invalid: value of pixels without a match.
        window: side of the photometric window, odd [px].
        smoothing: side of the window over which refined disparities are averaged [px]. Right
            where `sensor.edge_free` holds for a window at least as large, as `StereoConfig`
            demands.
        bands: threads to work in.
    """
    planes = [np.empty(disparity.shape, np.float32) for _ in range(4)]
    quality = MatchQuality(*planes)

    def work(first: int, end: int) -> None:
        _refine_rows(left, right, disparity, invalid, window // 2, first, end, *quality)

    bands.run(work)
    if smoothing > 1:
        smooth = cv2.blur(quality.disparity, (smoothing, smoothing))
        quality = quality._replace(disparity=np.asarray(smooth, dtype=np.float32))
    return quality


def is_determined(
    quality: MatchQuality, config: StereoConfig, bands: RowBands
) -> NDArray[np.bool_]:
    """Matches with the least texture and the least contrast to what they do not explain.

    Args:
        quality: of the matches.
        config: min_texture.
        bands: threads to work in.

    Returns:
        shape (H, W), bool.
    """
    determined = np.empty(quality.gradient.shape, np.bool_)
    least = np.float32(config.min_texture**2)

    def work(first: int, end: int) -> None:
        planes = (p[first:end] for p in (quality.gradient, quality.residual, determined))
        _find_determined(least, _MIN_CONTRAST, *planes)

    bands.run(work)
    return determined


@kernel
def _find_determined(least, contrast, gradient, residual, determined):  # type: ignore[no-untyped-def]
    height, width = determined.shape
    for v in range(height):
        for u in range(width):
            g = gradient[v, u]
            determined[v, u] = (g >= least) & (g >= contrast * residual[v, u])


@njit(nogil=True, cache=True, error_model="numpy")
def _refine_rows(  # type: ignore[no-untyped-def]
    left, right, disparity, invalid, reach, first, end, refined, residual, gradient, curvature
):
    """Slide a window down the image: the samples of its rows are kept in a ring."""
    height, width = disparity.shape
    rows = 2 * reach + 1
    ring = np.zeros((rows, _CHANNELS, width), np.float32)
    samples = np.zeros((_CHANNELS, width), np.float32)
    columns = np.zeros((_CHANNELS, width), np.float64)
    padded = np.zeros(width + 2 * reach, np.float32)
    sums = np.zeros((_CHANNELS, width), np.float32)
    for v in range(first - reach, end + reach):
        if 0 <= v < height:
            _sample_row(left[v], right[v], disparity[v], invalid, samples)
        else:
            samples[:] = 0.0
        oldest = ring[v % rows]
        for c in range(_CHANNELS):
            _slide(columns[c], oldest[c], samples[c])
        out = v - reach
        if out >= first:
            _sum_columns(columns, reach, padded, sums)
            _solve_row(sums, disparity[out], refined[out])
            _residual_row(sums, residual[out])
            _mean_row(sums[0], sums[3], gradient[out])
            _mean_row(sums[0], sums[6], curvature[out])


@kernel
def _sample_row(left, right, disparity, invalid, samples):  # type: ignore[no-untyped-def]
    """Gradient and photometric difference of every match in a row, and their products."""
    width = disparity.size
    count, gradient, difference, bend = samples[0], samples[1], samples[2], samples[6]
    samples[:] = 0.0
    for u in range(1, width - 1):
        place = SUBPIXELS * u - np.int32(disparity[u])
        first = place >> 4
        if disparity[u] <= invalid or first < 1 or first > width - 3:
            continue
        t = np.float32(place & 15) * np.float32(1.0 / SUBPIXELS)
        r0, r1 = np.float32(right[first - 1]), np.float32(right[first])
        r2, r3 = np.float32(right[first + 1]), np.float32(right[first + 2])
        l0, l1, l2 = np.float32(left[u - 1]), np.float32(left[u]), np.float32(left[u + 1])
        slope = (r2 - r0) + t * ((r3 - r1) - (r2 - r0))
        count[u] = 1.0
        gradient[u] = np.float32(0.25) * (slope + (l2 - l0))
        difference[u] = l1 - (r1 + t * (r2 - r1))
        bend[u] = l0 - np.float32(2.0) * l1 + l2
    _multiply(gradient, gradient, samples[3])
    _multiply(gradient, difference, samples[4])
    _multiply(difference, difference, samples[5])
    _multiply(bend, bend, bend)


@kernel
def _multiply(first, second, product):  # type: ignore[no-untyped-def]
    for u in range(product.size):
        product[u] = first[u] * second[u]


@kernel
def _slide(total, oldest, newest):  # type: ignore[no-untyped-def]
    """Move a running sum by one row; in double precision, so that it does not drift."""
    for u in range(total.size):
        total[u] += np.float64(newest[u]) - np.float64(oldest[u])
        oldest[u] = newest[u]


@kernel
def _sum_columns(columns, reach, padded, sums):  # type: ignore[no-untyped-def]
    """Sum ``2 reach + 1`` neighboring columns."""
    channels, width = columns.shape
    for c in range(channels):
        for u in range(width):
            padded[reach + u] = columns[c, u]
        if reach == 3:
            _sum_seven(padded, sums[c])
        else:
            _sum_neighbors(padded, 2 * reach + 1, sums[c])


@kernel
def _sum_seven(padded, total):  # type: ignore[no-untyped-def]
    """`_sum_neighbors` for the default window, in one pass."""
    for u in range(total.size):
        first = (padded[u] + padded[u + 1]) + (padded[u + 2] + padded[u + 3])
        total[u] = first + ((padded[u + 4] + padded[u + 5]) + padded[u + 6])


@kernel
def _sum_neighbors(padded, number, total):  # type: ignore[no-untyped-def]
    width = total.size
    for u in range(width):
        total[u] = padded[u]
    for shift in range(1, number):
        for u in range(width):
            total[u] += padded[u + shift]


# One loop per result: the compiler does not vectorise a loop that writes several arrays.


@kernel
def _solve_row(sums, disparity, refined):  # type: ignore[no-untyped-def]
    """One Gauss-Newton step per pixel, with the mean brightness difference removed."""
    most = np.float32(_LARGEST_STEP)
    count, g, e, gg, ge = sums[0], sums[1], sums[2], sums[3], sums[4]
    for u in range(disparity.size):
        share = np.float32(1.0) / max(count[u], np.float32(1.0))
        cross = share * (ge[u] - share * g[u] * e[u])
        spread = max(share * (gg[u] - share * g[u] * g[u]), np.float32(0.0))
        step = -cross / (spread + np.float32(_GRADIENT_NOISE))
        fixed = np.float32(disparity[u]) * np.float32(1.0 / SUBPIXELS)
        refined[u] = fixed + min(max(step, -most), most)


@kernel
def _residual_row(sums, residual):  # type: ignore[no-untyped-def]
    """Variance of the photometric difference that the step leaves."""
    count, g, e, gg, ge, ee = sums[0], sums[1], sums[2], sums[3], sums[4], sums[5]
    for u in range(residual.size):
        share = np.float32(1.0) / max(count[u], np.float32(1.0))
        cross = share * (ge[u] - share * g[u] * e[u])
        spread = max(share * (gg[u] - share * g[u] * g[u]), np.float32(0.0))
        explained = cross * cross / (spread + np.float32(_GRADIENT_NOISE))
        residual[u] = max(share * (ee[u] - share * e[u] * e[u]) - explained, np.float32(0.0))


@kernel
def _mean_row(count, total, mean):  # type: ignore[no-untyped-def]
    for u in range(mean.size):
        mean[u] = total[u] / max(count[u], np.float32(1.0))
