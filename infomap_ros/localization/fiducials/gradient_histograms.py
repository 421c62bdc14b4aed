"""Descriptors of image patches: histograms of gradients, at a spacing and turn that are asked for.

The layout is that of SIFT (D. G. Lowe 2004, DOI 10.1023/B:VISI.0000029664.99615.94): 16 x 16
gradients in 4 x 4 cells of 8 directions, weighted by a Gaussian and shared between neighboring
bins. Square roots of the shares compare better than the shares themselves (R. Arandjelovic and A.
Zisserman 2012, DOI 10.1109/CVPR.2012.6248018). There is no search for a scale or a direction: the
scale follows from the range, the direction from the pose that is expected.
"""

from __future__ import annotations

import cv2
import numpy as np
from numba import njit
from numpy.typing import NDArray

from infomap_ros.geometry.transforms import FloatArray

LENGTH = 128
"""Numbers of one descriptor."""

_GRID = 16  # gradients along a side
_CELLS = 4
_DIRECTIONS = 8
_SMOOTHING = 0.8  # of each level of the pyramid [px]
_WINDOW_SIGMA = 2.0  # of the Gaussian weight [cells]


def gradient_histograms(
    image: NDArray[np.uint8],
    pixels: FloatArray,
    spacings: tuple[float, ...],
    turn: float = 0.0,
) -> NDArray[np.uint8]:
    """Describe patches at several scales.

    Args:
        image: gray, shape (H, W); goes on beyond its border as its outermost pixels do.
        pixels: centers, shape (N, 2) [px].
        spacings: distances of neighboring gradients [px], S of them.
        turn: of the patches, from u towards v [rad].

    Returns:
        Square roots of the histograms' shares times 255, shape (N, S, 128), uint8; all zero where
        there is no gradient.
    """
    places = np.ascontiguousarray(pixels, dtype=np.float64).reshape(-1, 2)
    described = np.zeros((len(places), len(spacings), LENGTH), np.float32)
    levels = [max(0, round(np.log2(spacing))) for spacing in spacings]
    smooth, along = image, (np.cos(turn), np.sin(turn))
    for level in range(max(levels, default=0) + 1):
        smooth = image if level == 0 else cv2.pyrDown(smooth)
        blurred = np.asarray(cv2.GaussianBlur(smooth, (0, 0), _SMOOTHING))
        here = (places + 0.5) / 2.0**level - 0.5
        for scale, spacing in enumerate(spacings):
            if levels[scale] == level:
                step = spacing / 2.0**level
                _describe_all(blurred, here, step * along[0], step * along[1], described[:, scale])
    return np.asarray(np.rint(255.0 * described), dtype=np.uint8)


@njit(nogil=True, cache=True, error_model="numpy")
def _describe_all(image, pixels, du, dv, described):  # type: ignore[no-untyped-def]
    patch = np.empty((_GRID + 2, _GRID + 2))
    for n in range(len(pixels)):
        _sample(image, pixels[n, 0], pixels[n, 1], du, dv, patch)
        histogram = described[n]
        for j in range(_GRID):
            for i in range(_GRID):
                along = patch[j + 1, i + 2] - patch[j + 1, i]
                down = patch[j + 2, i + 1] - patch[j, i + 1]
                _vote(i, j, along, down, histogram)
        total = histogram.sum()
        if total > 0.0:
            for k in range(LENGTH):
                histogram[k] = np.sqrt(histogram[k] / total)


@njit(nogil=True, cache=True, error_model="numpy")
def _sample(image, u, v, du, dv, patch):  # type: ignore[no-untyped-def]
    """Bilinear samples on a square grid about a pixel, its rows along (du, dv), clamped."""
    height, width = image.shape
    middle = 0.5 * (patch.shape[0] - 1)
    for j in range(patch.shape[0]):
        y = j - middle
        for i in range(patch.shape[1]):
            x = i - middle
            s = min(max(u + x * du - y * dv, 0.0), width - 1.001)
            t = min(max(v + x * dv + y * du, 0.0), height - 1.001)
            column, row = int(s), int(t)
            f, g = s - column, t - row
            top = image[row, column] * (1.0 - f) + image[row, column + 1] * f
            bottom = image[row + 1, column] * (1.0 - f) + image[row + 1, column + 1] * f
            patch[j, i] = top * (1.0 - g) + bottom * g


@njit(nogil=True, cache=True, error_model="numpy")
def _vote(i, j, along, down, histogram):  # type: ignore[no-untyped-def]
    """Share a gradient between the two nearest cells each way and the two nearest directions."""
    size = np.hypot(along, down)
    if size == 0.0:
        return
    middle = 0.5 * (_GRID - 1)
    x, y = (i - middle) * _CELLS / _GRID, (j - middle) * _CELLS / _GRID
    size *= np.exp(-(x * x + y * y) / (2.0 * _WINDOW_SIGMA**2))
    turn = np.arctan2(down, along) * _DIRECTIONS / (2.0 * np.pi) % _DIRECTIONS
    column, row = x + 0.5 * (_CELLS - 1), y + 0.5 * (_CELLS - 1)
    c, r, d = int(np.floor(column)), int(np.floor(row)), int(np.floor(turn))
    for q in range(2):
        for p in range(2):
            if not (0 <= c + p < _CELLS and 0 <= r + q < _CELLS):
                continue
            share = size * (1.0 - abs(column - c - p)) * (1.0 - abs(row - r - q))
            cell = ((r + q) * _CELLS + c + p) * _DIRECTIONS
            histogram[cell + d % _DIRECTIONS] += share * (1.0 - (turn - d))
            histogram[cell + (d + 1) % _DIRECTIONS] += share * (turn - d)
