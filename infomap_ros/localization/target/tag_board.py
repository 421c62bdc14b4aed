"""Tags of a known size at known places: what a board of AprilTags or ArUco markers looks like.

A board upright on a wall has its frame as a robot has (REP-103): x out of the board towards the
viewer, y to the viewer's right, z up. A board flat on the floor: x to the right and y to the top of
the print, z up. The origin is the middle of the board. So the target's frame serves as ``map``.

A board of tags as an image, for printing and for simulated worlds.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from matplotlib.figure import Figure
from matplotlib.image import imsave
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from infomap_ros.errors import ConfigError, InvalidInputError
from infomap_ros.geometry import make_transform, transform_points
from infomap_ros.geometry.atomic_file import replacing, save_figure
from infomap_ros.geometry.config import check_config, parameter, setting
from infomap_ros.geometry.transforms import FloatArray

FAMILIES = {
    "tag36h11": "DICT_APRILTAG_36H11",
    "tag36h10": "DICT_APRILTAG_36H10",
    "tag25h9": "DICT_APRILTAG_25H9",
    "tag16h5": "DICT_APRILTAG_16H5",
    "aruco_mip_36h12": "DICT_ARUCO_MIP_36H12",
    "aruco_original": "DICT_ARUCO_ORIGINAL",
    **{
        f"aruco{cells}x{cells}_{size}": f"DICT_{cells}X{cells}_{size}"
        for cells in (4, 5, 6, 7)
        for size in (50, 100, 250, 1000)
    },
}
"""OpenCV's names of the families."""
_UPRIGHT = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])


@dataclass(frozen=True)
class TagBoardConfig:
    """Which tags there are and where.

    Raises:
        ConfigError: a value is out of range, an id is not in the family or occurs twice, or the
            numbers of ids and poses do not fit.
    """

    family: str = parameter("tag36h11", "Family of the tags.", choices=tuple(FAMILIES))
    side: float = parameter(
        0.16, "Edge of the black square of one tag.", unit="m", low=0.005, high=5.0
    )
    columns: int = parameter(2, "Tags side by side.", low=1, high=30)
    rows: int = parameter(2, "Tags one below the other.", low=1, high=30)
    gap: float = parameter(
        0.04, "White between two tags; at least one cell of the tag.", unit="m", low=0.0, high=5.0
    )
    margin: float = setting(
        0.04, "White around the tags; at least one cell of the tag.", unit="m", low=0.0, high=5.0
    )
    first_id: int = parameter(
        0, "Id of the tag at the top left; the others count on, row by row.", low=0, high=2319
    )
    mounting: str = parameter(
        "upright",
        "How the board's frame lies: upright on a wall (x out of it, z up) or flat on the floor "
        "(z out of it).",
        choices=("upright", "flat"),
    )
    ids: tuple[int, ...] = parameter(
        (), "Ids in place of those that first_id counts; one per tag, row by row."
    )
    poses: tuple[float, ...] = parameter(
        (),
        "In place of the grid: six numbers per tag, its middle [m] and its rotation vector [rad] "
        "in the target's frame; a tag's own axes are x right and y up in the print, z out of it.",
    )

    def __post_init__(self) -> None:
        check_config(self)
        if len(self.poses) % 6:
            raise ConfigError("poses", self.poses, "six numbers per tag")
        count = len(self.poses) // 6 or self.columns * self.rows
        if self.ids and len(self.ids) != count:
            raise ConfigError("ids", self.ids, f"{count} ids, one per tag")
        known = dictionary(self.family).bytesList.shape[0]
        ids = self.ids or tuple(range(self.first_id, self.first_id + count))
        if len(set(ids)) != len(ids) or not all(0 <= one < known for one in ids):
            name = "ids" if self.ids else "first_id"
            raise ConfigError(name, getattr(self, name), f"different ids below {known}")
        cell = self.side / cells(self.family)
        if not self.poses and count > 1 and self.gap < 0.99 * cell:
            raise ConfigError("gap", self.gap, f"at least one cell, {cell:.3g} m")


def dictionary(family: str) -> cv2.aruco.Dictionary:
    """OpenCV's dictionary of a family of tags."""
    return cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, FAMILIES[family]))


def cells(family: str) -> int:
    """Cells along the edge of a tag, the black border included."""
    return int(dictionary(family).markerSize) + 2


@dataclass(frozen=True)
class TagBoard:
    """Where the corners of all tags of a board are.

    Attributes:
        config: what the board is made of.
    """

    config: TagBoardConfig = field(default_factory=TagBoardConfig)

    @cached_property
    def ids(self) -> tuple[int, ...]:
        """Ids of the tags, row by row."""
        config = self.config
        count = len(config.poses) // 6 or config.columns * config.rows
        return config.ids or tuple(range(config.first_id, config.first_id + count))

    @cached_property
    def size(self) -> tuple[float, float]:
        """Width and height of the print, the margin included [m]; of a grid only."""
        config = self.config
        pitch = config.side + config.gap
        width = config.columns * pitch - config.gap + 2.0 * config.margin
        return width, config.rows * pitch - config.gap + 2.0 * config.margin

    @cached_property
    def T_target_board(self) -> FloatArray:
        """The print's axes (x right, y up, z towards the viewer) in the target's frame, (4, 4)."""
        upright = self.config.mounting == "upright" and not self.config.poses
        return make_transform(_UPRIGHT if upright else np.eye(3), np.zeros(3))

    @cached_property
    def tag_poses(self) -> FloatArray:
        """``T_target_tag`` of every tag, shape (T, 4, 4)."""
        config = self.config
        if config.poses:
            numbers = np.reshape(np.asarray(config.poses, dtype=np.float64), (-1, 6))
            turns = Rotation.from_rotvec(numbers[:, 3:]).as_matrix()
            pairs = zip(turns, numbers[:, :3], strict=True)
            return np.stack([make_transform(turn, middle) for turn, middle in pairs])
        pitch = config.side + config.gap
        right = (np.arange(config.columns) - 0.5 * (config.columns - 1)) * pitch
        up = -(np.arange(config.rows) - 0.5 * (config.rows - 1)) * pitch
        middles = [(x, y, 0.0) for y in up for x in right]
        return np.stack([self.T_target_board @ make_transform(np.eye(3), m) for m in middles])

    def in_frame(self, T_frame_target: FloatArray) -> TagBoard:
        """The same tags as a board whose target frame is another one, shape (4, 4)."""
        poses = T_frame_target @ self.tag_poses
        turns = Rotation.from_matrix(poses[:, :3, :3]).as_rotvec()
        numbers = tuple(np.hstack([poses[:, :3, 3], turns]).ravel().tolist())
        return TagBoard(replace(self.config, ids=self.ids, poses=numbers))

    @cached_property
    def corners(self) -> FloatArray:
        """Corners of every black square in the target's frame, shape (T, 4, 3) [m].

        In the order top left, top right, bottom right, bottom left of the print.
        """
        half = 0.5 * self.config.side
        square = np.array([[-half, half, 0], [half, half, 0], [half, -half, 0], [-half, -half, 0]])
        return np.stack([transform_points(pose, square) for pose in self.tag_poses])


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
        with replacing(path) as file:
            imsave(file, image, cmap="gray", vmin=0, vmax=255, dpi=dots_per_inch, format="png")
    else:
        height, width = image.shape
        page = Figure(figsize=(width / dots_per_inch, height / dots_per_inch), dpi=dots_per_inch)
        page.figimage(image, cmap="gray", vmin=0, vmax=255)
        save_figure(page, path, dots_per_inch)


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
