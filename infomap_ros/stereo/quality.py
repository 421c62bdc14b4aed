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

from infomap_ros.stereo.matching import SUBPIXELS

#: Keeps the step small where the gradient is at the level of image noise [grey levels^2].
_GRADIENT_NOISE = 5.0
_LARGEST_STEP = 0.5


class MatchQuality(NamedTuple):
    """Refined disparity and what it rests on, all of shape (H, W), float32.

    Attributes:
        disparity: refined disparity [px]; meaningless where there was no match.
        residual: variance of the photometric difference in the window that the refinement does
            not explain [grey levels^2].
        gradient: mean squared horizontal gradient in the window [(grey levels/px)^2].
        curvature: mean squared second horizontal derivative [(grey levels/px^2)^2].
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
) -> MatchQuality:
    """Refine a disparity image and measure the quality of its matches.

    Args:
        left: grey image, shape (H, W).
        right: grey image, shape (H, W).
        disparity: of the left pixels, shape (H, W) [1/16 px].
        invalid: value of pixels without a match.
        window: side of the photometric window [px].
        smoothing: side of the window over which refined disparities are averaged [px]. Right
            where `filters.edge_free` holds for a window at least as large.
    """
    height, width = disparity.shape
    samples = np.empty((height, width, 7), np.float32)
    _sample(left, right, disparity, invalid, samples)
    sums = cv2.boxFilter(samples, -1, (window, window), borderType=cv2.BORDER_CONSTANT)
    planes = [np.empty((height, width), np.float32) for _ in range(4)]
    quality = MatchQuality(*planes)
    _solve(sums, disparity, *quality)
    if smoothing > 1:
        smooth = cv2.blur(quality.disparity, (smoothing, smoothing))
        quality = quality._replace(disparity=np.asarray(smooth, dtype=np.float32))
    return quality


@njit(nogil=True, cache=True)
def _sample(left, right, disparity, invalid, samples):  # type: ignore[no-untyped-def]
    """Products of gradient and difference at the matched place: 1, g, e, gg, ge, ee, hh."""
    height, width = disparity.shape
    for v in range(height):
        for u in range(width):
            d = disparity[v, u]
            place = np.float32(u) - np.float32(d) / np.float32(SUBPIXELS)
            first = int(np.floor(place))
            if d <= invalid or u < 1 or u > width - 2 or first < 1 or first > width - 3:
                samples[v, u, :] = 0.0
                continue
            t = place - np.float32(first)
            r0, r1 = np.float32(right[v, first - 1]), np.float32(right[v, first])
            r2, r3 = np.float32(right[v, first + 1]), np.float32(right[v, first + 2])
            l0, l1, l2 = (
                np.float32(left[v, u - 1]),
                np.float32(left[v, u]),
                np.float32(left[v, u + 1]),
            )
            slope = (r2 - r0) + t * ((r3 - r1) - (r2 - r0))
            g = np.float32(0.25) * (slope + (l2 - l0))
            e = l1 - (r1 + t * (r2 - r1))
            h = l0 - np.float32(2.0) * l1 + l2
            samples[v, u, 0] = 1.0
            samples[v, u, 1] = g
            samples[v, u, 2] = e
            samples[v, u, 3] = g * g
            samples[v, u, 4] = g * e
            samples[v, u, 5] = e * e
            samples[v, u, 6] = h * h


@njit(nogil=True, cache=True)
def _solve(sums, disparity, refined, residual, gradient, curvature):  # type: ignore[no-untyped-def]
    """One Gauss-Newton step of every pixel, with the mean brightness difference removed."""
    height, width = disparity.shape
    for v in range(height):
        for u in range(width):
            count = max(sums[v, u, 0], np.float32(1e-3))
            share = np.float32(1.0) / count
            mean_g, mean_e = sums[v, u, 1] * share, sums[v, u, 2] * share
            gg = sums[v, u, 3] * share
            ge = sums[v, u, 4] * share - mean_g * mean_e
            ee = sums[v, u, 5] * share - mean_e * mean_e
            spread = max(gg - mean_g * mean_g, np.float32(0.0)) + np.float32(_GRADIENT_NOISE)
            step = -ge / spread
            step = min(max(step, np.float32(-_LARGEST_STEP)), np.float32(_LARGEST_STEP))
            refined[v, u] = np.float32(disparity[v, u]) / np.float32(SUBPIXELS) + step
            residual[v, u] = max(ee - ge * ge / spread, np.float32(0.0))
            gradient[v, u] = gg
            curvature[v, u] = sums[v, u, 6] * share
