"""Disparities of a few pixels of a rectified pair, without matching the whole image.

Each pixel is searched for along its row by zero-mean normalized cross-correlation, found again from
the right image (left-right check), and refined to a fraction of a pixel: Gauss-Newton on the
photometric error of the window over the disparity, its slope across the window (Lucas and Kanade
1981; a slanted surface has another disparity at each pixel of the window) and how far the match is
off its row, with the mean and the contrast of both windows made equal, because the two cameras may
be exposed differently. Rows of real rectified pairs differ by some tenths of a pixel, up to a pixel
at the borders; a match that is kept on its row would take that for disparity wherever an edge is
slanted, with the same sign all over a part of the image where edges run alike.

With R the rms photometric difference that the match leaves and g the rms gradient along the row,
image noise displaces a match by R / g over the square root of the number of independent samples.
What real images add (lenses, calibration, reflections, shape within the window) is correlated
across the window, so that far fewer samples than pixels are independent:

    sigma_d^2 = sigma_floor^2 + (sigma_residual R / g)^2

Both numbers are calibrated on pairs with true disparity (docs/localization.md): 0.08 px where the
rectification is exact. The floor is larger by the 0.1 px that calibrations in use leave beside it.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.localization.fiducials.patch_alignment import sample_patch

_ITERATIONS = 8
_CONVERGED = 0.01  # [px]
# Standard deviation of the disparity slope of a surface, as prior knowledge.
_SLOPE_SIGMA = 0.3
# Likewise of how far a match is off its row [px]: what is left by calibrations in use.
_ROW_SIGMA = 0.5
# Variance of the photometric noise that the prior is weighed against [gray levels^2].
_PHOTOMETRIC_VARIANCE = 9.0
# The best match must lead by this much correlation, however good it is.
_LEAST_LEAD = 0.02
# Quantization of 8-bit images [gray levels^2], [(gray levels/px)^2].
_RESIDUAL_NOISE, _GRADIENT_NOISE = 0.1, 0.1
# Matches this near to the best one do not rival it [px].
_SAME_PEAK = 2
_WINDOW = 11  # side of the matching window, odd [px]
_MIN_CORRELATION = 0.7  # normalized cross-correlation that a match must have
# The best match must lack at most this share of the correlation that the second best lacks.
_MAX_RIVALRY = 0.8
_LEFT_RIGHT_TOLERANCE = 1.0  # of the match found from the right image [px]
_SIGMA_FLOOR = 0.13  # disparity sigma of a perfect match: calibration, lenses and surfaces [px]
_SIGMA_RESIDUAL = 0.2  # disparity sigma as a share of the photometric residual over the gradient


def match_pixels(
    left: NDArray[np.uint8],
    right: NDArray[np.uint8],
    pixels: FloatArray,
    search: tuple[int, int],
) -> tuple[FloatArray, FloatArray]:
    """Measure the disparity of single pixels.

    Args:
        left: rectified image, shape (H, W).
        right: rectified image, shape (H, W).
        pixels: (u, v) in the left image, anywhere between pixel centers, shape (N, 2) [px].
        search: smallest and largest disparity that may occur [px].

    Returns:
        Disparities and their standard deviations, shape (N,) each [px]; NaN where there is no
        match that can be trusted.
    """
    quality = np.full((len(pixels), 3), np.nan)
    limits = (_MIN_CORRELATION, _MAX_RIVALRY, _LEFT_RIGHT_TOLERANCE)
    places = np.ascontiguousarray(pixels, dtype=np.float64)
    _match_all(left, right, places, search, _WINDOW // 2, limits, quality)
    disparity, residual, gradient = quality.T
    residual = residual + _RESIDUAL_NOISE
    # Noise in both images adds an eighth of its variance to the mean squared gradient.
    slope = np.maximum(gradient - residual / 8.0, gradient / 4.0) + _GRADIENT_NOISE
    matching = _SIGMA_RESIDUAL**2 * residual / slope
    return disparity.copy(), np.sqrt(_SIGMA_FLOOR**2 + matching)


@njit(nogil=True, cache=True, error_model="numpy")
def _match_all(left, right, pixels, search, reach, limits, quality):  # type: ignore[no-untyped-def]
    lowest, highest = search
    height, width = left.shape
    scores = np.empty(highest - lowest + 1, np.float32)
    least, rivalry, tolerance = limits
    for n in range(len(pixels)):
        u, v = pixels[n]
        if not (reach + 1 <= u < width - reach - 2 and reach + 1 <= v < height - reach - 2):
            continue
        column, row = int(np.rint(u)), int(np.rint(v))
        correlate(left, right, column, row, lowest, -1, reach, scores)
        best = _best_match(scores, least, rivalry)
        if best < 0:
            continue
        correlate(right, left, column - (lowest + best), row, lowest, 1, reach, scores)
        if abs(np.argmax(scores) - best) <= tolerance:
            _refine(left, right, u, v, float(lowest + best), reach, least, quality[n])


@njit(nogil=True, cache=True, error_model="numpy")
def correlate(image, other, column, row, lowest, sign, reach, scores):  # type: ignore[no-untyped-def]
    """Zero-mean normalized cross-correlation along a row, for every shift.

    ``scores[k]`` compares the window of `image` about (column, row) with that of `other` about
    (column + sign * (lowest + k), row); -1 where that window is not wholly inside.
    """
    size = 2 * reach + 1
    count = np.float32(size * size)
    window = np.empty((size, size), np.float32)
    for j in range(size):
        for i in range(size):
            window[j, i] = image[row - reach + j, column - reach + i]
    window -= np.float32(window.mean())
    energy = np.float32((window * window).sum())
    for k in range(len(scores)):
        first = column + sign * (lowest + k) - reach
        scores[k] = -1.0
        if first < 0 or first + size > other.shape[1]:
            continue
        total, square, cross = np.float32(0.0), np.float32(0.0), np.float32(0.0)
        for j in range(size):
            line = other[row - reach + j]
            for i in range(size):
                value = np.float32(line[first + i])
                total += value
                square += value * value
                cross += value * window[j, i]
        spread = square - total * total / count
        scores[k] = cross / np.sqrt(max(spread * energy, np.float32(1.0)))


@njit(nogil=True, cache=True, error_model="numpy")
def _best_match(scores, least, rivalry):  # type: ignore[no-untyped-def]
    """Index of the best score; -1 where it is too low, at an end, or has a rival."""
    best = int(np.argmax(scores))
    if scores[best] < least or best in (0, len(scores) - 1):
        return -1
    second = np.float32(-1.0)
    for k in range(len(scores)):
        if abs(k - best) > _SAME_PEAK and scores[k] > second:
            second = scores[k]
    lead = scores[best] - second
    return best if lead >= max((1.0 - rivalry) * (1.0 - second), _LEAST_LEAD) else -1


@njit(nogil=True, cache=True, error_model="numpy")
def _refine(left, right, u, v, start, reach, least, quality):  # type: ignore[no-untyped-def]
    """Sub-pixel disparity by Gauss-Newton; writes disparity, residual, squared gradient."""
    size = 2 * reach + 1
    template, warped = np.empty((size, size)), np.empty((size, size))
    slope = np.empty((size, size))
    sample_patch(left, u, v, 1.0, 0.0, 0.0, 1.0, template)
    template -= template.mean()
    energy = (template * template).sum()
    p = np.array([start, 0.0, 0.0, 0.0])
    step = np.zeros(4)
    down = np.empty((size, size))
    for _ in range(_ITERATIONS):
        if not sample_patch(right, u - p[0], v + p[3], 1.0 - p[1], -p[2], 0.0, 1.0, warped):
            return
        _equalise(warped, energy)
        _row_slopes(warped, slope)
        _row_slopes(warped.T, down.T)
        _normal_step(template, warped, slope, down, p, step)
        p += step
        if abs(step[0]) < _CONVERGED:
            break
    if abs(p[0] - start) > 1.0 or abs(step[0]) >= 0.1:
        return
    if not sample_patch(right, u - p[0], v + p[3], 1.0 - p[1], -p[2], 0.0, 1.0, warped):
        return
    _equalise(warped, energy)
    residual = ((template - warped) ** 2).mean()
    if (template * warped).mean() * size * size < least * energy:
        return
    quality[0], quality[1], quality[2] = p[0], residual, _mean_gradient(template)


@njit(nogil=True, cache=True, error_model="numpy")
def _equalise(warped, energy):  # type: ignore[no-untyped-def]
    """Give a window zero mean and the wanted energy, in place; returns the factor."""
    warped -= warped.mean()
    gain = np.sqrt(energy / max((warped * warped).sum(), 1.0))
    warped *= gain
    return gain


@njit(nogil=True, cache=True, error_model="numpy")
def _row_slopes(patch, slope):  # type: ignore[no-untyped-def]
    """Derivative along rows: central differences, one-sided at the ends."""
    size = patch.shape[1]
    for j in range(patch.shape[0]):
        slope[j, 0] = patch[j, 1] - patch[j, 0]
        slope[j, size - 1] = patch[j, size - 1] - patch[j, size - 2]
        for i in range(1, size - 1):
            slope[j, i] = 0.5 * (patch[j, i + 1] - patch[j, i - 1])


@njit(nogil=True, cache=True, error_model="numpy")
def _normal_step(template, warped, slope, down, p, step):  # type: ignore[no-untyped-def]
    """One step over (d, dd/du, dd/dv, row offset); priors keep slopes and offset small."""
    size = template.shape[0]
    reach = size // 2
    normal, right_side, row = np.zeros((4, 4)), np.zeros(4), np.empty(4)
    mean, mean_down = slope.mean(), down.mean()
    for j in range(size):
        for i in range(size):
            g = -(slope[j, i] - mean)
            e = template[j, i] - warped[j, i]
            row[0], row[1], row[2] = g, g * float(i - reach), g * float(j - reach)
            row[3] = down[j, i] - mean_down
            for k in range(4):
                right_side[k] += row[k] * e
                for m in range(k, 4):
                    normal[k, m] += row[k] * row[m]
    for k in range(4):
        sigma = _ROW_SIGMA if k == 3 else _SLOPE_SIGMA
        prior = 1e-6 if k == 0 else _PHOTOMETRIC_VARIANCE / sigma**2
        normal[k, k] += prior
        for m in range(k):
            normal[k, m] = normal[m, k]
        if k > 0:
            right_side[k] -= prior * p[k]
    step[:] = np.linalg.solve(normal, right_side)
    step[0] = min(max(step[0], -0.5), 0.5)
    step[3] = min(max(step[3], -0.5), 0.5)


@njit(nogil=True, cache=True, error_model="numpy")
def _mean_gradient(template):  # type: ignore[no-untyped-def]
    """Mean squared derivative along rows."""
    size = template.shape[0]
    total = 0.0
    for j in range(size):
        for i in range(1, size - 1):
            total += (0.5 * (template[j, i + 1] - template[j, i - 1])) ** 2
    return total / (size * (size - 2))
