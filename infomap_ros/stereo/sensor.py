"""The stereo range sensor: a rectified pair in, points with honest covariances out."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from infomap_ros.geometry import StereoRig
from infomap_ros.stereo.assembly import assemble, assemble_printed
from infomap_ros.stereo.bands import RowBands
from infomap_ros.stereo.config import StereoConfig
from infomap_ros.stereo.filters import (
    drop_inconsistent,
    drop_speckles,
    edge_free,
    has_support,
)
from infomap_ros.stereo.images import check_image, gray
from infomap_ros.stereo.matching import DisparityMatcher, DisparityRange, disparity_range
from infomap_ros.stereo.noise import StereoRange, range_from_disparity, sigma_from_quality
from infomap_ros.stereo.quality import MatchQuality, is_determined, refine
from infomap_ros.stereo.range_cloud import RangeCloud, mark_correlation


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

    @property
    def depth_limits(self) -> tuple[float, float]:
        """Nearest and farthest depth that the searched disparities reach [m]."""
        nearest = float(self.rig.depth_from_disparity(self.search.maximum))
        return max(nearest, self.config.min_depth), self.config.max_depth

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
            config.refinement_window,
            config.smoothing_window,
            self._bands,
        )
        keep = edge_free(checked, invalid, config, self.rig)
        keep &= is_determined(quality, config, self._bands)
        keep &= has_support(keep, config.min_support)
        return keep, quality

    def _assemble(self, ranges: StereoRange, image: NDArray[np.uint8]) -> NDArray[np.float32]:
        camera, config = self.rig.left, self.config
        if config.noise_model == "printed":
            focal_baseline = camera.fx * self.rig.baseline
            return assemble_printed(
                camera, focal_baseline, ranges.depth, config, image, self._bands
            )
        variance = ranges.variance
        return assemble(camera, ranges.depth, variance, config.pixel_sigma, image, self._bands)
