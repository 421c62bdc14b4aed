"""Two rooms with a door between them, tables, shelves and cabinets."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from infomap_ros.geometry.config import check_config, parameter
from infomap_ros.simulation.worlds import textures
from infomap_ros.simulation.worlds.builder import SceneBuilder, World
from infomap_ros.simulation.worlds.rocks import Places, upright
from infomap_ros.simulation.worlds.target_board import hang_board
from infomap_ros.simulation.worlds.terrain import Terrain

_WALL = 0.12  # [m] thickness
_OVERLAP = 0.002  # [m] of the pieces of a wall
_GAP = 0.9  # [m] between things, for robots of 0.4 m
_BESIDE, _EYE_LEVEL, _FRAME = 0.27, 0.7, 0.025  # [m] of the target: beside the door, up, ahead
_LAMPS = (0.62, 0.62, 0.60)


@dataclass(frozen=True)
class OfficeConfig:
    """Parameters of the office."""

    seed: int = parameter(7, "Seed of everything random in the world", low=0)
    size: float = parameter(7.0, "Length of both rooms together", unit="m", low=5.0, high=30.0)
    depth: float = parameter(4.5, "Width of the rooms", unit="m", low=3.0, high=30.0)
    wall: float = parameter(1.5, "Height of the walls", unit="m", low=0.5, high=4.0)
    door: float = parameter(1.1, "Width of the door", unit="m", low=0.7, high=3.0)
    furniture: int = parameter(9, "Number of pieces, as far as they fit", low=0, high=200)
    target: bool = parameter(True, "Whether a board with tags hangs on the wall ahead.")
    texture_size: int = parameter(1024, "Edge length of the textures", unit="px", low=64, high=8192)

    def __post_init__(self) -> None:
        """Validate all fields."""
        check_config(self)


def office(config: OfficeConfig | None = None, description: str = "") -> World:
    """Two rooms; the robot starts in the first, the door is in the wall ahead or behind.

    Args:
        config: the parameters.
        description: URDF text of a robot to put in; empty for none.
    """
    config = config or OfficeConfig()
    rng, look = (np.random.default_rng(s) for s in np.random.SeedSequence(config.seed).spawn(2))
    x, y = 0.5 * config.size, 0.5 * config.depth
    nodes = 2 * round(4.0 * (max(x, y) + 0.5)) + 1
    builder = SceneBuilder(Terrain(np.zeros((nodes, nodes)), max(x, y) + 0.5))
    builder.region = np.array([(-x, -y, -0.1), (x, y, config.wall)])
    builder.start = (-0.5 * x, 0.0, 0.0)
    builder.ambient = _LAMPS
    _add_materials(builder, config.texture_size, look)
    builder.add_terrain("ground")
    places = Places(rng, _GAP)
    places.take(*builder.start[:2], 0.2)
    _add_walls(builder, places, config, rng)
    for index in range(config.furniture):
        _add_piece(builder, places, f"{index}", (x, y), rng)
    if description:
        builder.add_robot(description, "paint")
    return builder.compile()


def _add_materials(builder: SceneBuilder, size: int, rng: np.random.Generator) -> None:
    small = max(64, size // 2)
    builder.add_ground_material("ground", textures.carpet(size, rng), tile=1.6)
    builder.add_material("plaster", textures.plaster(size, rng))
    builder.add_material("bricks", textures.bricks(size, rng))
    builder.add_material("wood", textures.wood(small, rng))
    builder.add_material("crate", textures.crate(small, rng))
    builder.add_material("paint", textures.worn_paint(small, rng))


def _add_walls(
    builder: SceneBuilder, places: Places, config: OfficeConfig, rng: np.random.Generator
) -> None:
    """Outer walls in pieces of about 2 m, so that the texture keeps its scale; and the inner."""
    x, y = 0.5 * config.size, 0.5 * config.depth
    offset = 0.5 * _WALL
    corners = np.array(
        [(-x, -y - offset), (x, -y - offset), (x, y + offset), (-x, y + offset)], dtype=float
    )
    _add_wall(builder, "south", corners[0], corners[1], config.wall, "plaster")
    _add_wall(builder, "north", corners[3], corners[2], config.wall, "bricks")
    east, west = np.array((x + offset, y)), np.array((-x - offset, y))
    _add_wall(builder, "east", east * (1, -1), east, config.wall, "plaster")
    _add_wall(builder, "west", west * (1, -1), west, config.wall, "bricks")
    inner = float(rng.uniform(-0.05, 0.1)) * x
    door = float(rng.uniform(-0.5, 0.5)) * y
    low, high = door - 0.5 * config.door, door + 0.5 * config.door
    _add_wall(
        builder, "inner_a", np.array((inner, -y)), np.array((inner, low)), config.wall, "plaster"
    )
    _add_wall(
        builder, "inner_b", np.array((inner, high)), np.array((inner, y)), config.wall, "plaster"
    )
    places.take(inner, door, 0.5)
    if config.target:
        _hang_target(builder, places, inner, (low, high))


def _hang_target(
    builder: SceneBuilder, places: Places, inner: float, door: tuple[float, float]
) -> None:
    """Hang the board with tags beside the door, as near to straight ahead as the wall allows."""
    low, high = door
    y = min(low - _BESIDE, 0.0) if low + high > 0.0 else max(high + _BESIDE, 0.0)
    hang_board(builder, upright(inner - 0.5 * _WALL - _FRAME, y, _EYE_LEVEL, np.pi))
    places.take(inner, y, 0.3)


def _add_wall(
    builder: SceneBuilder,
    name: str,
    start: np.ndarray,
    end: np.ndarray,
    height: float,
    material: str,
) -> None:
    length = float(np.linalg.norm(end - start))
    count = max(1, round(length / 2.0))
    yaw = float(np.arctan2(*(end - start)[::-1]))
    for index in range(count):
        x, y = start + (end - start) * (index + 0.5) / count
        size = (length / count + _OVERLAP, _WALL, height + 0.1)
        pose = upright(float(x), float(y), 0.5 * height - 0.05, yaw)
        builder.add_box(f"wall_{name}_{index}", size, pose, material)


def _add_piece(
    builder: SceneBuilder,
    places: Places,
    name: str,
    room: tuple[float, float],
    rng: np.random.Generator,
) -> None:
    """A table, shelf or cabinet where there is room, square to the walls."""
    kind = int(rng.integers(3))
    radius = (0.62, 0.5, 0.33)[kind]
    corner = (room[0] - radius, room[1] - radius)
    place = places.find((-corner[0], -corner[1]), corner, radius)
    if place is None:
        return
    yaw = 0.5 * np.pi * int(rng.integers(4))
    if kind == 0:
        _add_table(builder, name, place, yaw)
    elif kind == 1:
        _add_shelf(builder, name, place, yaw)
    else:
        height = float(rng.uniform(0.35, 0.9))
        pose = upright(*place, 0.5 * height - 0.01, yaw)
        builder.add_box(f"cabinet_{name}", (0.45, 0.42, height), pose, "crate")


def _add_table(builder: SceneBuilder, name: str, place: tuple[float, float], yaw: float) -> None:
    middle = upright(*place, 0.0, yaw)
    builder.add_box(f"table_{name}", (1.0, 0.6, 0.03), middle @ _at(0.0, 0.0, 0.7), "wood")
    for index, (x, y) in enumerate(((-1, -1), (-1, 1), (1, -1), (1, 1))):
        leg = middle @ _at(0.45 * x, 0.25 * y, 0.34)
        builder.add_box(f"table_{name}_leg_{index}", (0.05, 0.05, 0.7), leg, "paint")


def _add_shelf(builder: SceneBuilder, name: str, place: tuple[float, float], yaw: float) -> None:
    middle = upright(*place, 0.0, yaw)
    for index, side in enumerate((-0.4, 0.4)):
        board = middle @ _at(side, 0.0, 0.54)
        builder.add_box(f"shelf_{name}_side_{index}", (0.03, 0.32, 1.1), board, "wood")
    builder.add_box(f"shelf_{name}_back", (0.83, 0.02, 1.1), middle @ _at(0.0, 0.16, 0.54), "crate")
    for index, height in enumerate((0.06, 0.42, 0.75, 1.08)):
        board = middle @ _at(0.0, 0.0, height)
        builder.add_box(f"shelf_{name}_{index}", (0.78, 0.30, 0.03), board, "wood")


def _at(x: float, y: float, z: float) -> np.ndarray:
    return upright(x, y, z, 0.0)
