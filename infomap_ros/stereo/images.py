"""Checks of images at the public door.

Work on the rows of an image in a few threads.

The kernels of this room release the GIL and are compiled for one thread each: numba's own
parallel loops can end the process when two threads of a node enter them at once.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor, wait
from itertools import pairwise

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


class RowBands:
    """Splits the rows of an image into equal bands, one per thread."""

    def __init__(self, height: int, threads: int = 1) -> None:
        """Plan the bands.

        Args:
            height: rows of the image [px].
            threads: number of bands; the caller's thread works on the first one.
        """
        edges = [height * i // threads for i in range(threads + 1)]
        self._bands = list(pairwise(edges))
        self._pool = ThreadPoolExecutor(threads - 1, "stereo") if threads > 1 else None

    def run(self, work: Callable[[int, int], object]) -> None:
        """Call ``work(first_row, end_row)`` for every band and wait for all of them.

        An error of one band is raised when all have ended, so that no thread goes on with arrays
        that the caller takes for its own again.
        """
        others = [self._pool.submit(work, *band) for band in self._bands[1:]] if self._pool else []
        try:
            work(*self._bands[0])
        finally:
            wait(others)
        for other in others:
            other.result()
