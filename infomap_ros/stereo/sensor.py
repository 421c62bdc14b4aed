"""The stereo range sensor: a rectified pair in, points with honest covariances out."""

from __future__ import annotations

import math

import cv2
import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray

from infomap_ros.geometry import StereoRig
from infomap_ros.geometry.kernel import kernel
from infomap_ros.stereo.config import StereoConfig
from infomap_ros.stereo.images import RowBands, check_image, gray
from infomap_ros.stereo.matching import SUBPIXELS, DisparityMatcher, DisparityRange, disparity_range
from infomap_ros.stereo.noise import StereoRange, range_from_disparity, sigma_from_quality
from infomap_ros.stereo.quality import (
    REFINEMENT_WINDOW,
    SMOOTHING_WINDOW,
    MatchQuality,
    is_determined,
    refine,
)
from infomap_ros.stereo.range_cloud import RangeCloud, assemble, assemble_printed, mark_correlation

_SUPPORT = (9, 9)  # [px]
_MIN_SUPPORT = 0.5  # share of the pixels about one that must be kept, else it stands alone
_SPECKLE_RANGE = 1.0  # neighbors that differ by less belong to one patch [px]
# Pixels with a disparity jump or a hole within this window are dropped (foreground fattening) [px].
_EDGE_WINDOW = 5
_EDGE_THRESHOLD = 2.0  # disparity range within it that is a jump [px]
_EDGE_NOISE = 1.0  # likewise that is none, however steep: a match may have it by chance [px]
# Standard deviation of the viewing ray across the image; the footprint of a pixel has 0.29 [px].
_PIXEL_SIGMA = 0.3


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
        config: speckle_size.
    """
    if config.speckle_size > 0:
        step = round(_SPECKLE_RANGE * SUBPIXELS)
        cv2.filterSpeckles(disparity, invalid, config.speckle_size, step)


def edge_free(
    disparity: NDArray[np.int16], invalid: int, config: StereoConfig, rig: StereoRig
) -> NDArray[np.bool_]:
    """Pixels with neither a jump of disparity nor a hole within `_EDGE_WINDOW`.

    Semi-global matching smears the foreground over the background by about half a block at
    depth edges; such pixels carry the error of a whole jump and no sigma can describe them. A jump
    of 2 px is little where things are near and a tenth of the depth or more where they are far. A
    plane seen at an angle a from its normal has, at the disparity D from infinity, a gradient of
    tan(a) D / f: what is steeper than that for any angle one believes in is a jump.

    Args:
        disparity: shape (H, W) [1/16 px].
        invalid: value of pixels without a match.
        config: max_grazing_angle.
        rig: the pair.

    Returns:
        shape (H, W), bool; False too within the window of the image border.
    """
    window = np.ones((_EDGE_WINDOW, _EDGE_WINDOW), np.uint8)
    low, high = cv2.erode(disparity, window), cv2.dilate(disparity, window)
    keep = np.empty(disparity.shape, np.bool_)
    steepest = (_EDGE_WINDOW - 1) * math.tan(config.max_grazing_angle) / rig.left.fx
    limits = np.array((_EDGE_NOISE, _EDGE_THRESHOLD), np.float32) * SUBPIXELS
    offset = np.float32(rig.principal_offset * SUBPIXELS)
    _smooth_places(low, high, invalid, limits, np.float32(steepest), offset, _EDGE_WINDOW, keep)
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


class StereoRangeSensor:
    """Measures range with a rectified stereo pair.

    Attributes:
        rig: the pair.
        config: parameters.
        search: disparities that are searched.
    """

    def __init__(self, rig: StereoRig, config: StereoConfig | None = None) -> None:
        """Prepare the matcher.

        Args:
            rig: rectified pair.
            config: parameters; defaults where None.

        Raises:
            CalibrationError: the image is too narrow for a search.
        """
        self.rig = rig
        self.config = config or StereoConfig()
        self.search: DisparityRange = disparity_range(rig, self.config)
        self._matcher = DisparityMatcher(self.search, self.config)
        self._bands = RowBands(rig.left.height, self.config.threads)

    def measure(self, left: ArrayLike, right: ArrayLike) -> RangeCloud:
        """Measure the range of every pixel of the left image that can be trusted.

        Args:
            left: rectified image, shape (H, W) or (H, W, 3) RGB, uint8.
            right: rectified image, shape (H, W) or (H, W, 3) RGB, uint8.

        Returns:
            Organized cloud in the optical frame of the left camera.

        Raises:
            InvalidInputError: an image has the wrong type or number of channels.
            CalibrationError: an image does not have its camera's size.
        """
        left_image = check_image(left, self.rig.left, "left image")
        right_image = check_image(right, self.rig.right, "right image")
        left_gray, right_gray = gray(left_image), gray(right_image)
        disparity = self.match(left_gray, right_gray)
        return self.measure_matched(left_image, left_gray, right_gray, disparity)

    def match(self, left: NDArray[np.uint8], right: NDArray[np.uint8]) -> NDArray[np.int16]:
        """Raw disparities of a gray pair, see `DisparityMatcher.match`."""
        return self._matcher.match(left, right)

    def measure_matched(
        self,
        left_image: NDArray[np.uint8],
        left_gray: NDArray[np.uint8],
        right_gray: NDArray[np.uint8],
        disparity: NDArray[np.int16],
    ) -> RangeCloud:
        """All of `measure` that comes after the matcher.

        Args:
            left_image: checked image for the colors, shape (H, W) or (H, W, 3).
            left_gray: shape (H, W).
            right_gray: shape (H, W).
            disparity: the matcher's, shape (H, W) [1/16 px].
        """
        keep, quality = self.assess(left_gray, right_gray, disparity)
        sigma = sigma_from_quality(quality, self.config, self._bands)
        ranges = range_from_disparity(
            self.rig, self.config, keep, quality.disparity, sigma, self._bands
        )
        return RangeCloud(
            camera=self.rig.left,
            packed=mark_correlation(
                self._assemble(ranges, left_image), self.config.error_correlation
            ),
            range_image=ranges.depth,
            error_correlation=self.config.error_correlation,
            disparity=ranges.disparity,
            disparity_sigma=ranges.disparity_sigma,
            colors=left_image if left_image.ndim == 3 else None,
        )

    def assess(
        self,
        left: NDArray[np.uint8],
        right: NDArray[np.uint8],
        disparity: NDArray[np.int16],
    ) -> tuple[NDArray[np.bool_], MatchQuality]:
        """Filter and refine the matcher's disparities.

        Args:
            left: gray image, shape (H, W).
            right: gray image, shape (H, W).
            disparity: the matcher's, shape (H, W) [1/16 px].

        Returns:
            Which pixels are kept, shape (H, W), and the quality of every match.
        """
        config, invalid = self.config, self._matcher.invalid
        checked = drop_inconsistent(disparity, invalid, config.left_right_tolerance, self._bands)
        drop_speckles(checked, invalid, config)
        quality = refine(
            left,
            right,
            checked,
            invalid,
            REFINEMENT_WINDOW,
            SMOOTHING_WINDOW,
            self._bands,
        )
        keep = edge_free(checked, invalid, config, self.rig)
        keep &= is_determined(quality, config, self._bands)
        keep &= has_support(keep, _MIN_SUPPORT)
        return keep, quality

    def _assemble(self, ranges: StereoRange, image: NDArray[np.uint8]) -> NDArray[np.float32]:
        camera, config = self.rig.left, self.config
        if config.noise_model == "printed":
            focal_baseline = camera.fx * self.rig.baseline
            return assemble_printed(
                camera, focal_baseline, ranges.depth, config, image, self._bands
            )
        variance = ranges.variance
        return assemble(camera, ranges.depth, variance, _PIXEL_SIGMA, image, self._bands)
