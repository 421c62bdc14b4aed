"""Which matches are kept: consistency, speckles, edges."""

from __future__ import annotations

import math

import cv2
import numpy as np
from numba import njit
from numpy.typing import NDArray

from infomap_ros.geometry import StereoRig
from infomap_ros.geometry.kernel import kernel
from infomap_ros.stereo.bands import RowBands
from infomap_ros.stereo.config import StereoConfig
from infomap_ros.stereo.matching import SUBPIXELS

_SUPPORT = (9, 9)  # [px]


def drop_inconsistent(
    disparity: NDArray[np.int16], invalid: int, tolerance: int, bands: RowBands
) -> NDArray[np.int16]:
    """Left-right check: drop pixels whose place in the right image a nearer pixel hides.

    Args:
        disparity: shape (H, W) [1/16 px].
        invalid: value of pixels without a match.
        tolerance: largest difference of disparity to the nearest claimant [px].
        bands: threads to work in.

    Returns:
        Copy, shape (H, W) [1/16 px], with `invalid` where the check failed or where the match
        lies outside the right image.
    """
    checked = np.empty_like(disparity)
    step = tolerance * SUBPIXELS

    def work(first: int, end: int) -> None:
        _check_rows(disparity[first:end], invalid, step, checked[first:end])

    bands.run(work)
    return checked


@njit(nogil=True, cache=True, error_model="numpy")
def _check_rows(disparity, invalid, tolerance, checked):  # type: ignore[no-untyped-def]
    height, width = disparity.shape
    claim = np.empty(width, np.int16)
    for v in range(height):
        claim[:] = invalid
        for u in range(width):
            d = disparity[v, u]
            if d > invalid:
                target = u - ((d + 8) >> 4)
                if 0 <= target < width and d > claim[target]:
                    claim[target] = d
        for u in range(width):
            d = disparity[v, u]
            checked[v, u] = invalid
            if d > invalid:
                target = u - ((d + 8) >> 4)
                if 0 <= target < width and d >= claim[target] - tolerance:
                    checked[v, u] = d


def drop_speckles(disparity: NDArray[np.int16], invalid: int, config: StereoConfig) -> None:
    """Set patches of fewer than speckle_size pixels to `invalid`, in place.

    Args:
        disparity: shape (H, W) [1/16 px].
        invalid: value of pixels without a match.
        config: speckle_size and speckle_range.
    """
    if config.speckle_size > 0:
        step = round(config.speckle_range * SUBPIXELS)
        cv2.filterSpeckles(disparity, invalid, config.speckle_size, step)


def edge_free(
    disparity: NDArray[np.int16], invalid: int, config: StereoConfig, rig: StereoRig
) -> NDArray[np.bool_]:
    """Pixels with neither a jump of disparity nor a hole within edge_window.

    Semi-global matching smears the foreground over the background by about half a block at
    depth edges; such pixels carry the error of a whole jump and no sigma can describe them. A jump
    of 2 px is little where things are near and a tenth of the depth or more where they are far. A
    plane seen at an angle a from its normal has, at the disparity D from infinity, a gradient of
    tan(a) D / f: what is steeper than that for any angle one believes in is a jump.

    Args:
        disparity: shape (H, W) [1/16 px].
        invalid: value of pixels without a match.
        config: edge_window, edge_threshold, max_grazing_angle and edge_noise.
        rig: the pair.

    Returns:
        shape (H, W), bool; False too within the window of the image border.
    """
    window = np.ones((config.edge_window, config.edge_window), np.uint8)
    low, high = cv2.erode(disparity, window), cv2.dilate(disparity, window)
    keep = np.empty(disparity.shape, np.bool_)
    steepest = (config.edge_window - 1) * math.tan(config.max_grazing_angle) / rig.left.fx
    limits = np.array((config.edge_noise, config.edge_threshold), np.float32) * SUBPIXELS
    offset = np.float32(rig.principal_offset * SUBPIXELS)
    _smooth_places(
        low, high, invalid, limits, np.float32(steepest), offset, config.edge_window, keep
    )
    return keep


@kernel
def _smooth_places(low, high, invalid, limits, steepest, offset, window, keep):  # type: ignore[no-untyped-def]
    height, width = keep.shape
    rim, (least, most) = window // 2 + 1, limits
    keep[:] = False
    for v in range(rim, height - rim):
        for u in range(rim, width - rim):
            bottom = np.float32(low[v, u])
            limit = min(max(steepest * (bottom + offset), least), most)
            keep[v, u] = (low[v, u] > invalid) & (np.float32(high[v, u]) - bottom < limit)


def has_support(keep: NDArray[np.bool_], share: float) -> NDArray[np.bool_]:
    """Pixels about which at least a `share` of the 9 x 9 pixels is kept, shape (H, W)."""
    mask = keep.view(np.uint8)
    kept = cv2.boxFilter(mask, cv2.CV_8U, _SUPPORT, normalize=False, borderType=cv2.BORDER_CONSTANT)
    return np.asarray(kept >= math.ceil(share * _SUPPORT[0] * _SUPPORT[1]))
