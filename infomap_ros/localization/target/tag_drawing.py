"""A board of tags as an image, for printing and for simulated worlds."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np
from matplotlib.figure import Figure
from matplotlib.image import imsave
from numpy.typing import NDArray

from infomap_ros.errors import ConfigError, InvalidInputError
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.localization.target.tag_board import TagBoard, TagBoardConfig, cells, dictionary

aruco: Any = cv2.aruco  # whose functions were renamed in OpenCV 4.7
_INCH = 0.0254
_LARGEST = 20_000  # [px] edge of an image


def draw_board(config: TagBoardConfig, pixels_per_meter: float) -> NDArray[np.uint8]:
    """Draw a board, exactly to scale: a pixel that an edge cuts gets its share of gray.

    Args:
        config: a grid of tags.
        pixels_per_meter: resolution [px/m].

    Returns:
        Gray image, shape (H, W), uint8; top of the print in row 0, the middle of the image is
        the origin of the board.

    Raises:
        ConfigError: the tags are not in a grid.
        InvalidInputError: the image would be empty or larger than 20,000 px.
    """
    if config.poses:
        raise ConfigError("poses", config.poses, "a grid, as only that can be drawn on one sheet")
    board = TagBoard(config)
    width, height = (max(0, round(edge * pixels_per_meter)) for edge in board.size)
    if not (0 < width <= _LARGEST and 0 < height <= _LARGEST):
        problem = f"{pixels_per_meter} makes an image of {width}x{height} px"
        raise InvalidInputError("pixels_per_meter", problem)
    dark = np.zeros((height, width))
    plane = np.linalg.inv(board.T_target_board)
    for tag, pose in zip(board.ids, board.tag_poses, strict=True):
        x, y, _ = (plane @ pose)[:3, 3]
        pattern = _dark_cells(config.family, tag)
        across = _shares(x, config.side, len(pattern), width, pixels_per_meter)
        down = _shares(-y, config.side, len(pattern), height, pixels_per_meter)
        dark += down @ pattern @ across.T
    return np.rint(255.0 * (1.0 - np.clip(dark, 0.0, 1.0))).astype(np.uint8)


def save_board(config: TagBoardConfig, path: Path, dots_per_inch: int = 300) -> None:
    """Write a board as .png (with its resolution) or .pdf, in true scale.

    Args:
        config: a grid of tags.
        path: file to write; the ending decides.
        dots_per_inch: resolution.

    Raises:
        ConfigError: the tags are not in a grid.
        InvalidInputError: the ending is neither, or the image would be too large.
    """
    if path.suffix.lower() not in {".png", ".pdf"}:
        raise InvalidInputError("path", f"{path.name} ends neither in .png nor in .pdf")
    image = draw_board(config, dots_per_inch / _INCH)
    if path.suffix.lower() == ".png":
        imsave(path, image, cmap="gray", vmin=0, vmax=255, dpi=dots_per_inch, format="png")
    else:
        height, width = image.shape
        page = Figure(figsize=(width / dots_per_inch, height / dots_per_inch), dpi=dots_per_inch)
        page.figimage(image, cmap="gray", vmin=0, vmax=255)
        page.savefig(path, format="pdf", dpi=dots_per_inch)


def _dark_cells(family: str, tag: int) -> FloatArray:
    """One for the black cells of a tag, shape (cells, cells), the top row first."""
    side = cells(family)
    draw = getattr(aruco, "generateImageMarker", None) or aruco.drawMarker  # before 4.7
    image = draw(dictionary(family), tag, side)
    return np.asarray(image == 0, dtype=np.float64)


def _shares(middle: float, side: float, count: int, length: int, scale: float) -> FloatArray:
    """How much of each pixel of a row each cell covers, shape (length, count)."""
    edges = (middle - 0.5 * side + side / count * np.arange(count + 1)) * scale + 0.5 * length
    pixels = np.arange(length)[:, None]
    low = np.maximum(pixels, edges[:-1])
    high = np.minimum(pixels + 1, edges[1:])
    return np.maximum(high - low, 0.0)
