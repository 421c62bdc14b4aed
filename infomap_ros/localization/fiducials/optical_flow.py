"""Where pixels of one image went in the next: pyramidal Lucas-Kanade, forward and back."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import cv2
import numpy as np
from numpy.typing import NDArray

from infomap_ros.errors import ConfigError
from infomap_ros.geometry.config import check_config, setting
from infomap_ros.geometry.transforms import FloatArray

# Brightness is made equal where mean or contrast of the images differ by more than this.
_SAME_MEAN = 3.0  # [gray levels]
_SAME_CONTRAST = 0.03
_LEAST_CONTRAST = 1.0  # [gray levels]


@dataclass(frozen=True)
class OpticalFlowConfig:
    """How pixels are followed from image to image.

    Raises:
        ConfigError: a value is out of its range.
    """

    window: int = setting(21, "Side of the window, odd.", unit="px", low=5, high=61)
    levels: ClassVar[int] = 4
    """Levels of the image pyramid; each doubles the step that is followed."""
    iterations: int = setting(20, "Most iterations per level.", low=1, high=100)
    max_round_trip: ClassVar[float] = 1.0
    """A pixel must come back to where it was by this, when followed forward and back [px]."""

    def __post_init__(self) -> None:
        check_config(self)
        if self.window % 2 == 0:
            raise ConfigError("window", self.window, "an odd number")


class OpticalFlow:
    """Follows pixels from the image before to the next.

    B. D. Lucas and T. Kanade, *An iterative image registration technique*, IJCAI 1981, in the
    pyramidal form of J.-Y. Bouguet, as OpenCV has it. A change of the whole image's brightness and
    contrast between the two is taken out first.
    """

    def __init__(self, config: OpticalFlowConfig | None = None) -> None:
        self.config = config or OpticalFlowConfig()
        self._image: NDArray[np.uint8] | None = None

    def remember(self, image: NDArray[np.uint8]) -> None:
        """Take an image, shape (H, W), as the one from which `follow` goes on."""
        self._image = image

    def follow(
        self, image: NDArray[np.uint8], pixels: FloatArray, start: FloatArray
    ) -> tuple[FloatArray, NDArray[np.bool_]]:
        """Find pixels of the remembered image in another, which is remembered in its place.

        Args:
            image: shape (H, W).
            pixels: in the remembered image, shape (N, 2) [px].
            start: where they are expected in `image`, shape (N, 2) [px].

        Returns:
            Where they are, shape (N, 2) [px], and whether they came back, shape (N,).
        """
        before, self._image = self._image, image
        if before is None or len(pixels) == 0:
            return start.copy(), np.zeros(len(pixels), np.bool_)
        now = equalised(image, before)
        places = np.ascontiguousarray(pixels, np.float32)[:, None]
        guess = np.ascontiguousarray(start, np.float32)[:, None]
        there, forward = self._flow(before, now, places, guess)
        back, backward = self._flow(now, before, there, places.copy())
        missed = np.linalg.norm(back - places, axis=2)[:, 0]
        found = (forward & backward)[:, 0] & (missed <= self.config.max_round_trip)
        return there[:, 0].astype(np.float64), np.asarray(found)

    def _flow(
        self,
        before: NDArray[np.uint8],
        after: NDArray[np.uint8],
        pixels: NDArray[np.float32],
        guess: NDArray[np.float32],
    ) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
        there, status, _ = cv2.calcOpticalFlowPyrLK(
            before,
            after,
            pixels,
            guess.copy(),
            winSize=(self.config.window, self.config.window),
            maxLevel=self.config.levels - 1,
            criteria=(
                cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS,
                self.config.iterations,
                0.03,
            ),
            flags=cv2.OPTFLOW_USE_INITIAL_FLOW,
            minEigThreshold=1e-4,
        )
        return there, status.astype(np.bool_)


def equalised(image: NDArray[np.uint8], like: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """An image with the mean and contrast of another; itself where they are alike already."""
    mean, contrast = (float(value[0, 0]) for value in cv2.meanStdDev(image))
    wanted_mean, wanted_contrast = (float(value[0, 0]) for value in cv2.meanStdDev(like))
    gain = max(wanted_contrast, _LEAST_CONTRAST) / max(contrast, _LEAST_CONTRAST)
    if abs(mean - wanted_mean) < _SAME_MEAN and abs(gain - 1.0) < _SAME_CONTRAST:
        return image
    levels = np.clip(np.rint((np.arange(256) - mean) * gain + wanted_mean), 0, 255)
    return np.asarray(cv2.LUT(image, levels.astype(np.uint8)), dtype=np.uint8)
