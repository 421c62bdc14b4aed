"""The board of tags near the start of every world: what robots take for the origin of their map.

The front of the board shows the image that `infomap_ros.localization.target.tag_board` prints.
"""

from __future__ import annotations

import cv2
import numpy as np

from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.localization.target.tag_board import TagBoard, TagBoardConfig, draw_board
from infomap_ros.simulation.worlds.builder import SceneBuilder
from infomap_ros.simulation.worlds.rocks import Places, upright
from infomap_ros.simulation.worlds.textures import Image

WORLD_BOARD = TagBoardConfig(side=0.2, gap=0.03, margin=0.03)
"""The board of the simulated worlds, 0.49 m square: to be read from 0.6 m to 3.5 m."""

_THICKNESS = 0.02  # [m]
_TEXTURE = 512  # [px]
_LIFT = 0.12  # [m] of the lower edge above the ground
_BEARING = 0.25  # [rad]
_WHITE = 230  # paper does not reflect all light


def stand_board(builder: SceneBuilder, places: Places, x: float, y: float, yaw: float) -> None:
    """Stand the board on the ground.

    Args:
        builder: receives it.
        places: marks its place as taken.
        x: middle of its face in the world [m].
        y: likewise.
        yaw: where its face looks [rad].
    """
    width, height = TagBoard(WORLD_BOARD).size
    ground = float(builder.terrain.height((x, y)))
    middle = upright(x, y, ground + _LIFT + 0.5 * height, yaw)
    places.take(x, y, 0.5 * width)
    foot = middle @ _shift(-0.5 * _THICKNESS, -0.5 * (height + _LIFT) - 0.05)
    size = (_THICKNESS, 0.6 * width, _LIFT + 0.1)
    builder.add_material("target_foot", _gray(64))
    builder.add_box("target_foot", size, foot, "target_foot")
    hang_board(builder, middle)


def stand_board_ahead(builder: SceneBuilder, places: Places, distance: float) -> None:
    """Stand the board before a robot that starts at the origin, a little to the left of ahead.

    Its face is square to the world's x axis, so that the axes of map and world are parallel.

    Args:
        builder: receives it.
        places: marks its place as taken.
        distance: from the start [m].
    """
    x, y = distance * np.cos(_BEARING), distance * np.sin(_BEARING)
    stand_board(builder, places, float(x), float(y), np.pi)


def hang_board(builder: SceneBuilder, T_world_target: FloatArray) -> None:
    """Put the board into the world, its face in the plane x = 0 of the target's frame.

    Args:
        builder: receives it.
        T_world_target: shape (4, 4); z up, x out of the face.
    """
    width, height = TagBoard(WORLD_BOARD).size
    builder.add_faces("target", _face_images())
    box = T_world_target @ _shift(-0.5 * _THICKNESS, 0.0)
    builder.add_box("target", (_THICKNESS, width, height), box, "target")
    builder.T_world_target = T_world_target


def _shift(x: float, z: float) -> FloatArray:
    return upright(x, 0.0, z, 0.0)


def _gray(size: int) -> Image:
    return np.full((size, size, 3), 128, np.uint8)


def _face_images() -> tuple[Image, ...]:
    """Images of the faces +x, -x, +y, -y, +z, -z, as `SceneBuilder.add_faces` wants them."""
    width, _ = TagBoard(WORLD_BOARD).size
    print_ = draw_board(WORLD_BOARD, 2.0 * _TEXTURE / width)
    print_ = cv2.resize(print_, (_TEXTURE, _TEXTURE), interpolation=cv2.INTER_AREA)
    pixels = (print_.astype(np.float64) * (_WHITE / 255.0)).astype(np.uint8)
    front = np.repeat(pixels[..., None], 3, axis=-1)
    return (front, *[_gray(_TEXTURE)] * 5)
