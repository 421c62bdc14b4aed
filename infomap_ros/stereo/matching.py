"""Disparity search: the semi-global matcher and the range that it searches."""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from infomap_ros.errors import CalibrationError
from infomap_ros.geometry import StereoRig
from infomap_ros.geometry.kernel import kernel
from infomap_ros.stereo.config import StereoConfig

#: Disparities are whole multiples of 1 / SUBPIXELS px in the matcher's fixed-point output.
SUBPIXELS = 16
_MODES = {
    "sgbm_3way": cv2.STEREO_SGBM_MODE_SGBM_3WAY,
    "sgbm": cv2.STEREO_SGBM_MODE_SGBM,
    "sgbm_hh": cv2.STEREO_SGBM_MODE_HH,
}
# The only one with paths from below too: a path carries its disparity on, so that those of one
# side pull the result towards what lies there, by half a row after refinement.
_SYMMETRIC = "sgbm_hh"
# Largest difference of the two passes of the others that is noise [1/16 px].
_LARGEST_DIFFERENCE = 2 * SUBPIXELS
BLOCK_SIZE = 5
"""Side of the matching window, odd [px]."""
SMOOTHNESS_SMALL, SMOOTHNESS_LARGE = 8, 32
"""Penalties of a disparity step of 1 px and of more, per pixel of the block (P1, P2)."""


@dataclass(frozen=True)
class DisparityRange:
    """Disparities ``minimum .. minimum + count - 1`` [px]; count is a multiple of 16."""

    minimum: int
    count: int

    @property
    def maximum(self) -> int:
        """Largest whole disparity searched [px]."""
        return self.minimum + self.count - 1


def disparity_range(rig: StereoRig, config: StereoConfig) -> DisparityRange:
    """Disparities that the wanted depths need with this rig.

    The far end follows max_depth (and the principal offset of the rig), the near end min_depth,
    unless that needs more than max_search allows: then the far end is kept.

    Args:
        rig: rectified pair.
        config: min_depth, max_depth [m] and max_search.

    Raises:
        CalibrationError: the image is too narrow for any search.
    """
    minimum = math.floor(float(rig.disparity_from_depth(config.max_depth)))
    nearest = math.ceil(float(rig.disparity_from_depth(config.min_depth)))
    wanted = 16 * math.ceil((nearest - minimum + 1) / 16)
    allowed = 16 * math.floor(config.max_search * rig.left.width / 16)
    if allowed < 16:
        raise CalibrationError(
            f"image width {rig.left.width} px leaves no room for 16 disparities "
            f"(max_search = {config.max_search:g})"
        )
    return DisparityRange(minimum, min(wanted, allowed))


class DisparityMatcher:
    """Semi-global block matching (Hirschmueller 2008, DOI 10.1109/TPAMI.2007.1166) by OpenCV."""

    def __init__(self, search: DisparityRange, config: StereoConfig) -> None:
        self.search = search
        self._before, self._after = max(0, search.maximum), max(0, -search.minimum)
        self._is_symmetric = config.matcher == _SYMMETRIC
        self._matcher = cv2.StereoSGBM.create(
            minDisparity=search.minimum,
            numDisparities=search.count,
            blockSize=BLOCK_SIZE,
            P1=SMOOTHNESS_SMALL * BLOCK_SIZE**2,
            P2=SMOOTHNESS_LARGE * BLOCK_SIZE**2,
            disp12MaxDiff=config.left_right_tolerance,
            preFilterCap=0,  # OpenCV's default
            uniquenessRatio=config.uniqueness,
            mode=_MODES[config.matcher],
        )

    @property
    def invalid(self) -> int:
        """Fixed-point value of a pixel without a match."""
        return (self.search.minimum - 1) * SUBPIXELS

    def match(self, left: NDArray[np.uint8], right: NDArray[np.uint8]) -> NDArray[np.int16]:
        """Match a rectified gray pair.

        A variant whose paths all come from above passes over the pair a second time from below:
        where both find a match, the result is the mean.

        Args:
            left: shape (H, W).
            right: shape (H, W).

        Returns:
            Disparity of the left pixels in units of 1/16 px, shape (H, W); `invalid` where there
            is no unique match that the right image confirms.
        """
        left, right = self._extended(left), self._extended(right)
        disparity = self._matcher.compute(left, right)
        if not self._is_symmetric:
            upwards = self._matcher.compute(cv2.flip(left, 0), cv2.flip(right, 0))
            _take_mean(disparity, cv2.flip(upwards, 0), self.invalid)
        width = disparity.shape[1] - self._before - self._after
        return np.ascontiguousarray(disparity[:, self._before : self._before + width])

    def _extended(self, image: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """The image with room for candidates that lie outside the other image."""
        if not (self._before or self._after):
            return image
        border = cv2.BORDER_REPLICATE
        extended = cv2.copyMakeBorder(image, 0, 0, self._before, self._after, border)
        return np.asarray(extended, dtype=np.uint8)


@kernel
def _take_mean(downwards, upwards, invalid):  # type: ignore[no-untyped-def]
    """Replace a pass by the mean of two; `invalid` where they differ, one where it is alone."""
    height, width = downwards.shape
    for v in range(height):
        for u in range(width):
            first, second = np.int32(downwards[v, u]), np.int32(upwards[v, u])
            if first <= invalid or second <= invalid:
                downwards[v, u] = max(first, second)
            elif abs(first - second) > _LARGEST_DIFFERENCE:
                downwards[v, u] = invalid
            else:
                downwards[v, u] = (first + second) >> 1
