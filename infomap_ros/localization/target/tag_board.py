"""Tags of a known size at known places: what a board of AprilTags or ArUco markers looks like.

A board upright on a wall has its frame as a robot has (REP-103): x out of the board towards the
viewer, y to the viewer's right, z up. A board flat on the floor: x to the right and y to the top of
the print, z up. The origin is the middle of the board. So the target's frame serves as ``map``.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from infomap_ros.errors import ConfigError
from infomap_ros.geometry import make_transform, transform_points
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

    @cached_property
    def corners(self) -> FloatArray:
        """Corners of every black square in the target's frame, shape (T, 4, 3) [m].

        In the order top left, top right, bottom right, bottom left of the print.
        """
        half = 0.5 * self.config.side
        square = np.array([[-half, half, 0], [half, half, 0], [half, -half, 0], [-half, -half, 0]])
        return np.stack([transform_points(pose, square) for pose in self.tag_poses])
