"""Checks of images at the public door."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from infomap_ros.errors import CalibrationError, InvalidInputError
from infomap_ros.geometry import PinholeCamera


def check_image(image: ArrayLike, camera: PinholeCamera, name: str) -> NDArray[np.uint8]:
    """Return an 8-bit image after checking that it fits the camera.

    Args:
        image: shape (H, W), (H, W, 1) or (H, W, 3), uint8.
        camera: the camera that it should come from.
        name: how an error names it.

    Returns:
        The image, C-contiguous, shape (H, W) or (H, W, 3).

    Raises:
        InvalidInputError: wrong type or number of channels.
        CalibrationError: the size is not the camera's.
    """
    pixels = np.asarray(image)
    if pixels.dtype != np.uint8:
        raise InvalidInputError(name, f"dtype {pixels.dtype}, expected uint8")
    if pixels.ndim == 3 and pixels.shape[2] == 1:
        pixels = pixels[..., 0]
    if pixels.ndim not in (2, 3) or (pixels.ndim == 3 and pixels.shape[2] != 3):
        raise InvalidInputError(name, f"shape {pixels.shape}, expected (H, W) or (H, W, 3)")
    check_size(pixels.shape, camera, name)
    return np.ascontiguousarray(pixels)


def check_size(shape: tuple[int, ...], camera: PinholeCamera, name: str) -> None:
    """Refuse an image whose size the calibration is not for.

    Raises:
        CalibrationError: the size is not the camera's.
    """
    if shape[:2] != (camera.height, camera.width):
        raise CalibrationError(
            f"{name} is {shape[1]}x{shape[0]} px, its calibration is for "
            f"{camera.width}x{camera.height} px"
        )


def gray(image: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Luminance of an RGB image, shape (H, W); a gray image as it is."""
    if image.ndim == 2:
        return image
    return np.asarray(cv2.cvtColor(image, cv2.COLOR_RGB2GRAY), dtype=np.uint8)
