"""Seeded textured worlds: rough ground, boulders, and a few things that people made."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from infomap_ros.errors import InvalidInputError
from infomap_ros.geometry import make_transform, transform_points
from infomap_ros.geometry.config import check_config, parameter
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.simulation.worlds import textures
from infomap_ros.simulation.worlds.builder import SceneBuilder, World
from infomap_ros.simulation.worlds.file_world import (
    WORLD_FILES,
    FileWorldConfig,
    file_world,
    is_world_file,
)
from infomap_ros.simulation.worlds.natural import CaveConfig, MarsConfig, cave, mars
from infomap_ros.simulation.worlds.office import OfficeConfig, office
from infomap_ros.simulation.worlds.rocks import boulder
from infomap_ros.simulation.worlds.terrain import Terrain, rough_terrain


@dataclass(frozen=True)
class SceneConfig:
    """Parameters of a rocky world."""

    seed: int = parameter(7, "Seed of everything random in the world", low=0)
    size: float = parameter(14.0, "Edge length of the square ground", unit="m", low=6.0, high=60.0)
    spacing: float = parameter(
        0.035, "Distance of height field nodes", unit="m", low=0.01, high=0.5
    )
    relief: float = parameter(0.10, "Standard deviation of the relief", unit="m", low=0.0, high=1.0)
    roughness: float = parameter(
        0.012, "Standard deviation of bumps below 0.3 m", unit="m", low=0.0, high=0.2
    )
    boulders: int = parameter(34, "Number of boulders of 0.15 to 0.6 m", low=0, high=500)
    stones: int = parameter(150, "Number of stones of 0.03 to 0.12 m", low=0, high=2000)
    clearance: float = parameter(
        0.65, "Radius about the start that boulders keep free", unit="m", low=0.0, high=10.0
    )
    texture_size: int = parameter(
        2048, "Edge length of the ground texture", unit="px", low=64, high=8192
    )

    def __post_init__(self) -> None:
        """Validate all fields."""
        check_config(self)


def rover_rocks(config: SceneConfig | None = None, description: str = "") -> World:
    """A rock field with a brick wall, two equipment cases and a solar panel.

    The robot starts at the origin and looks along +x, where the things are.

    Args:
        config: the parameters.
        description: URDF text of a robot to put in; empty for none.
    """
    config = config or SceneConfig()
    rng = np.random.default_rng(config.seed)
    terrain = rough_terrain(0.5 * config.size, config.spacing, config.relief, config.roughness, rng)
    builder = SceneBuilder(terrain)
    _add_materials(builder, config.texture_size, rng)
    builder.add_terrain("ground")
    _add_structures(builder, terrain)
    _add_rocks(builder, config, rng)
    if description:
        builder.add_robot(description, "paint")
    return builder.compile()


@dataclass(frozen=True)
class Scene:
    """A kind of world.

    Attributes:
        config: class of its parameters; all have `seed` and `size`.
        build: makes the world, the robot of a URDF text in it if that is not empty.
    """

    config: type
    build: Callable[[Any, str], World]


SCENES = {
    "rover_rocks": Scene(SceneConfig, rover_rocks),
    "mars": Scene(MarsConfig, mars),
    "office": Scene(OfficeConfig, office),
    "cave": Scene(CaveConfig, cave),
    "file": Scene(FileWorldConfig, file_world),
}
"""Worlds by name."""

WORLDS = ("mars", "office", "cave")
"""Those of them that are explored: made from a seed, of any size."""


def scene_of(name: str, seed: int, **parameters: Any) -> tuple[str, Any]:
    """Key of `SCENES` and configuration of a world.

    Args:
        name: a key of `SCENES`, or a file of a world (`file_world.is_world_file`).
        seed: of everything random in it.
        parameters: further fields of the world's configuration.

    Raises:
        InvalidInputError: no such world, or no such parameter.
        ConfigError: a parameter is out of range.
    """
    if is_world_file(name):
        name, parameters = "file", {"file": str(Path(name).absolute()), **parameters}
    if name not in SCENES:
        known = ", ".join(key for key in SCENES if key != "file")
        files = ", ".join(WORLD_FILES)
        raise InvalidInputError("world", f"'{name}' is unknown; known: {known}; files: {files}")
    try:
        return name, SCENES[name].config(seed=seed, **parameters)
    except TypeError as error:
        raise InvalidInputError("world", f"'{name}': {error}") from error


def without_target(name: str) -> dict[str, Any]:
    """Parameters of a world of that name in which there is no board with tags; none for a file."""
    fields = {field.name for field in dataclasses.fields(SCENES[name].config)}
    return {key: 0 for key in ("target", "target_distance") if key in fields}


def make_world(name: str, seed: int, description: str = "", **parameters: Any) -> World:
    """Make a world from its name and a seed.

    Args:
        name: as of `scene_of`.
        seed: of everything random in it.
        description: URDF text of a robot to put in; empty for none.
        parameters: further fields of the world's configuration.

    Raises:
        InvalidInputError: no such world, or no such parameter.
        ConfigError: a parameter is out of range.
    """
    key, config = scene_of(name, seed, **parameters)
    return SCENES[key].build(config, description)


def describe_scene(name: str, config: Any) -> str:
    """Name and parameters of a world as JSON, from which `build_scene` makes it again."""
    return json.dumps({"scene": name, "config": dataclasses.asdict(config)})


def build_scene(text: str, description: str = "") -> World:
    """Build the world that `describe_scene` described, the robot of `description` in it.

    Raises:
        InvalidInputError: the text is not such a description or names an unknown scene.
        ConfigError: a parameter is out of range.
    """
    try:
        content = json.loads(text)
        scene = SCENES[content["scene"]]
        given = content["config"].items()
        config = {key: tuple(v) if isinstance(v, list) else v for key, v in given}
        return scene.build(scene.config(**config), description)
    except (json.JSONDecodeError, KeyError, TypeError) as error:
        raise InvalidInputError("scene", f"{error!r}; known: {', '.join(SCENES)}") from error


def _add_materials(builder: SceneBuilder, size: int, rng: np.random.Generator) -> None:
    small = max(64, size // 2)
    builder.add_ground_material("ground", textures.ground(size, rng), tile=2.6)
    builder.add_material("rock_0", textures.rock(small, rng, (1.0, 0.86, 0.76)))
    builder.add_material("rock_1", textures.rock(small, rng, (0.86, 0.86, 0.90)))
    builder.add_material("rock_2", textures.rock(small, rng, (1.15, 0.92, 0.74)))
    builder.add_material("bricks", textures.bricks(size, rng))
    builder.add_material("crate", textures.crate(small, rng))
    builder.add_material("cells", textures.solar_cells(small, rng))
    builder.add_material("paint", textures.worn_paint(small, rng))


def _pose(terrain: Terrain, x: float, y: float, lift: float, *angles: float) -> FloatArray:
    """A pose above the ground; angles are yaw, pitch, roll [rad]."""
    rotation = Rotation.from_euler("ZYX", (*angles, 0.0, 0.0, 0.0)[:3]).as_matrix()
    return make_transform(rotation, (x, y, float(terrain.height((x, y))) + lift))


def _add_structures(builder: SceneBuilder, terrain: Terrain) -> None:
    builder.add_box("wall", (0.18, 2.4, 1.15), _pose(terrain, 4.0, 0.55, 0.42, 0.22), "bricks")
    builder.add_box("wall_wing", (0.9, 0.18, 0.8), _pose(terrain, 3.7, -0.8, 0.28, 0.22), "bricks")
    builder.add_box("case_large", (0.6, 0.42, 0.36), _pose(terrain, 2.1, -1.05, 0.15, 0.5), "crate")
    builder.add_box(
        "case_small", (0.3, 0.3, 0.26), _pose(terrain, 1.25, 1.05, 0.10, -0.4, 0.05), "crate"
    )
    panel = _pose(terrain, 2.45, 1.55, 0.62, -2.5, 0.65)
    builder.add_box("panel", (0.8, 1.3, 0.035), panel, "cells")
    for name, along in (("post_left", 0.5), ("post_right", -0.5)):
        top = transform_points(panel, (0.0, along, -0.02))
        ground = float(terrain.height(top[:2])) - 0.1
        middle = make_transform(panel[:3, :3] @ _untilt(panel), (*top[:2], 0.5 * (top[2] + ground)))
        builder.add_box(name, (0.05, 0.05, float(top[2]) - ground - 0.03), middle, "paint")


def _untilt(transform: FloatArray) -> FloatArray:
    """Rotation that takes a tilted frame back to upright with the same heading."""
    heading = np.arctan2(transform[1, 0], transform[0, 0])
    upright = Rotation.from_euler("Z", heading).as_matrix()
    return np.asarray(transform[:3, :3].T @ upright)


# x, y [m], size [m]: rocks that every world has, in view of the start.
_LANDMARKS = (
    (1.45, 0.30, 0.34),
    (2.95, -0.05, 0.55),
    (1.05, -0.85, 0.28),
    (2.95, -1.95, 0.70),
    (1.75, 0.62, 0.20),
    (0.75, 1.75, 0.42),
    (1.9, 2.35, 0.60),
    (3.3, 2.2, 0.75),
    (0.9, -1.9, 0.50),
    (1.85, -0.25, 0.16),
)


def _add_rocks(builder: SceneBuilder, config: SceneConfig, rng: np.random.Generator) -> None:
    reach = 0.5 * config.size - 1.0
    for index, (x, y, extent) in enumerate(_LANDMARKS):
        size = extent * rng.uniform((0.8, 0.8, 0.65), (1.1, 1.1, 0.95))
        pose = _pose(builder.terrain, x, y, 0.2 * size[2], rng.uniform(-np.pi, np.pi))
        mesh = boulder((size[0], size[1], size[2]), rng)
        builder.add_mesh(f"landmark_{index}", *mesh, pose, f"rock_{rng.integers(3)}")
    # Smallest and largest extent [m], how many, how far out [m], subdivisions.
    _scatter(builder, (0.18, 0.60), config.boulders, reach, 4, config.clearance, rng)
    _scatter(builder, (0.03, 0.14), config.stones, 0.6 * reach, 3, config.clearance, rng)


def _scatter(
    builder: SceneBuilder,
    extents: tuple[float, float],
    count: int,
    reach: float,
    detail: int,
    clearance: float,
    rng: np.random.Generator,
) -> None:
    """Lay `count` rocks about the origin, denser towards it, none within `clearance` [m]."""
    smallest, largest = extents
    for index in range(count):
        extent = smallest * (largest / smallest) ** rng.uniform()
        radius = clearance + 0.6 * extent + (reach - clearance) * rng.uniform() ** 0.9
        bearing = rng.uniform(-np.pi, np.pi)
        x, y = radius * np.cos(bearing), radius * np.sin(bearing)
        size = extent * rng.uniform((0.75, 0.75, 0.55), (1.1, 1.1, 0.95))
        mesh = boulder((size[0], size[1], size[2]), rng, detail)
        pose = _pose(builder.terrain, x, y, 0.2 * size[2], rng.uniform(-np.pi, np.pi))
        name = f"rock_{smallest * 100:.0f}_{index}"
        builder.add_mesh(name, *mesh, pose, f"rock_{rng.integers(3)}")
