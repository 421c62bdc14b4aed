"""Pixels of image records as the stereo sensor wants them: gray or RGB of 8 bit."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from infomap_ros.errors import InvalidInputError
from infomap_ros.geometry.records import ImageRecord

_TO_RGB = {
    "rgb8": None,
    "bgr8": cv2.COLOR_BGR2RGB,
    "rgba8": cv2.COLOR_RGBA2RGB,
    "bgra8": cv2.COLOR_BGRA2RGB,
}
_SAME_LAYOUT = {"8UC1": "mono8", "8UC3": "bgr8", "8UC4": "bgra8", "16UC1": "mono16"}
_SIXTEEN_BIT = {"rgb16": "rgb8", "bgr16": "bgr8", "rgba16": "rgba8", "bgra16": "bgra8"}


def intensity_pixels(image: ImageRecord) -> NDArray[np.uint8]:
    """Gray or RGB pixels of 8 bit, shape (H, W) or (H, W, 3).

    Images of 16 bit lose their lower byte, whatever their content, so that the same brightness is
    the same number in both images of a pair and in every frame.

    Raises:
        InvalidInputError: the encoding is not that of a brightness or color image.
    """
    encoding = _SAME_LAYOUT.get(image.encoding, image.encoding)
    pixels: NDArray[Any] = image.pixels
    if encoding == "mono16" or encoding in _SIXTEEN_BIT:
        pixels = (pixels >> 8).astype(np.uint8)
        encoding = _SIXTEEN_BIT.get(encoding, "mono8")
    if encoding == "mono8":
        return pixels
    if encoding not in _TO_RGB:
        raise InvalidInputError("image", f"encoding '{image.encoding}' is not gray or color")
    conversion = _TO_RGB[encoding]
    return pixels if conversion is None else np.asarray(cv2.cvtColor(pixels, conversion), np.uint8)
