"""Tags on a simulated robot, by which its teammates find it.

They are seen, and neither touched nor heavy: what they hang on is the robot's description.
"""

from __future__ import annotations

import cv2
import numpy as np

from infomap_ros.errors import RobotModelError
from infomap_ros.geometry import make_transform, quaternion_from_transform
from infomap_ros.localization.target.tag_board import TagBoard, TagBoardConfig, cells
from infomap_ros.localization.target.tag_drawing import draw_board
from infomap_ros.simulation.worlds.builder import add_cube_material
from infomap_ros.simulation.worlds.textures import Image

import mujoco  # isort: skip  # after the backend has been chosen

_THICKNESS = 0.005  # [m]
_TEXTURE = 256  # [px]
_WHITE = 230  # paper does not reflect all light
_FACE = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]])  # of the plate, x out of it


def add_tag_plates(spec: mujoco.MjSpec, link: str, tags: TagBoardConfig) -> None:
    """Hang a plate for each tag on a robot in a world that is being built.

    Args:
        spec: the world.
        link: name of the robot's base in it.
        tags: where they are in the frame of the base (`localization.target.robot_tags.tag_pose`).

    Raises:
        RobotModelError: there is no such link.
    """
    body = spec.body(link)
    if body is None:
        raise RobotModelError(f"there is no link '{link}' for tags")
    board = TagBoard(tags)
    cell = tags.side / cells(tags.family)
    edge = tags.side + 2.0 * cell
    back = make_transform(_FACE, (0.0, 0.0, -0.5 * _THICKNESS))
    for tag, pose in zip(board.ids, board.tag_poses, strict=True):
        name, place = f"{link}/tag_{tag}", pose @ back
        add_cube_material(spec, name, _faces(tags, tag, cell))
        x, y, z, w = quaternion_from_transform(place)
        body.add_geom(
            name=name,
            type=mujoco.mjtGeom.mjGEOM_BOX,
            size=(0.5 * _THICKNESS, 0.5 * edge, 0.5 * edge),
            pos=place[:3, 3],
            quat=(w, x, y, z),
            material=name,
            mass=0.0,
            contype=0,
            conaffinity=0,
        )


def _faces(tags: TagBoardConfig, tag: int, cell: float) -> tuple[Image, ...]:
    """The print on the face +x, with a white rim of one cell; the others are gray."""
    one = TagBoardConfig(
        family=tags.family, side=tags.side, columns=1, rows=1, margin=cell, first_id=tag
    )
    width, _ = TagBoard(one).size
    drawn = cv2.resize(
        draw_board(one, 2.0 * _TEXTURE / width), (_TEXTURE, _TEXTURE), interpolation=cv2.INTER_AREA
    )
    pixels = (drawn.astype(np.float64) * (_WHITE / 255.0)).astype(np.uint8)
    gray = np.full((_TEXTURE, _TEXTURE, 3), 128, np.uint8)
    return (np.rot90(np.repeat(pixels[..., None], 3, axis=-1)), *[gray] * 5)
