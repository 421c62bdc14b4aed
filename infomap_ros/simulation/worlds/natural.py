"""Worlds with natural ground: a small crater with things that people left, and a cave."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from infomap_ros.geometry import transform_points
from infomap_ros.geometry.config import parameter
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.simulation.worlds import textures
from infomap_ros.simulation.worlds.builder import SceneBuilder, World
from infomap_ros.simulation.worlds.rocks import (
    Places,
    add_boulder,
    boulder,
    bounded_terrain,
    upright,
)
from infomap_ros.simulation.worlds.target_board import stand_board_ahead
from infomap_ros.simulation.worlds.terrain import (
    NaturalGroundConfig,
    Terrain,
    node_count,
    uneven_floor,
)

_RIM = 1.0  # [m] width of the rim
_GAP = 0.85  # [m] between things, for a rover of 0.4 m


@dataclass(frozen=True)
class MarsConfig(NaturalGroundConfig):
    """Parameters of the crater."""

    size: float = parameter(7.0, "Diameter of the crater's floor", unit="m", low=4.0, high=40.0)
    rim: float = parameter(0.75, "Height of the rim", unit="m", low=0.0, high=5.0)
    boulders: int = parameter(
        10, "Number of boulders of 0.25 to 0.8 m, as far as they fit", low=0, high=500
    )
    stones: int = parameter(60, "Number of stones of 0.02 to 0.05 m", low=0, high=2000)


def mars(config: MarsConfig | None = None, description: str = "") -> World:
    """A crater whose rim is too steep to be climbed; the robot starts in its middle.

    Args:
        config: the parameters.
        description: URDF text of a robot to put in; empty for none.
    """
    config = config or MarsConfig()
    rng, look = (np.random.default_rng(s) for s in np.random.SeedSequence(config.seed).spawn(2))
    builder = SceneBuilder(_crater(config, rng))
    radius = 0.5 * config.size
    low, high = (-radius, -radius, -0.5), (radius, radius, 1.3)
    builder.region = np.array([low, high])
    _add_materials(builder, config.texture_size, look)
    builder.add_terrain("ground")
    places = Places(rng, _GAP)
    places.take(0.0, 0.0, 0.15)
    if config.target_distance:
        stand_board_ahead(builder, places, config.target_distance)
    _add_panel(builder, places, radius, rng)
    _add_cases(builder, places, radius, rng)
    _add_rocks(builder, places, config, rng)
    if description:
        builder.add_robot(description, "paint")
    return builder.compile()


def _crater(config: MarsConfig, rng: np.random.Generator) -> Terrain:
    radius = 0.5 * config.size
    half = radius + _RIM
    n = node_count(config, half)
    axis = np.linspace(-half, half, n)
    x, y = np.meshgrid(axis, axis)
    distance, bearing = np.hypot(x, y), np.arctan2(y, x)
    phase = rng.uniform(0.0, 2.0 * np.pi, 2)
    uneven = 0.12 * np.sin(3.0 * bearing + phase[0]) + 0.08 * np.sin(5.0 * bearing + phase[1])
    floor = uneven_floor(config, n, rng)
    return bounded_terrain(half, floor, distance - radius - uneven + 0.2, config.rim, _RIM)


def _add_materials(builder: SceneBuilder, size: int, rng: np.random.Generator) -> None:
    small = max(64, size // 4)
    builder.add_ground_material("ground", textures.ground(size, rng), tile=2.6)
    builder.add_material("rock_0", textures.rock(small, rng, (1.0, 0.86, 0.76)))
    builder.add_material("rock_1", textures.rock(small, rng, (0.86, 0.86, 0.90)))
    builder.add_material("rock_2", textures.rock(small, rng, (1.15, 0.92, 0.74)))
    builder.add_material("crate", textures.crate(small, rng))
    builder.add_material("cells", textures.solar_cells(2 * small, rng))
    builder.add_material("paint", textures.worn_paint(small, rng))


def _add_panel(
    builder: SceneBuilder, places: Places, radius: float, rng: np.random.Generator
) -> None:
    """A panel of 0.75 x 1.2 m, tilted, on two posts."""
    place = places.find((-radius, -radius), (radius, radius), 0.7, radius)
    if place is None:
        return
    ground = float(builder.terrain.height(place))
    yaw = float(rng.uniform(-np.pi, np.pi))
    panel = upright(*place, ground + 0.55, yaw, float(rng.uniform(0.45, 0.75)))
    builder.add_box("panel", (0.75, 1.2, 0.035), panel, "cells")
    for name, along in (("post_left", 0.45), ("post_right", -0.45)):
        top = transform_points(panel, (0.0, along, -0.02))
        low = float(builder.terrain.height(top[:2])) - 0.1
        middle: FloatArray = upright(top[0], top[1], 0.5 * (top[2] + low), yaw)
        builder.add_box(name, (0.05, 0.05, float(top[2]) - low - 0.03), middle, "paint")


def _add_cases(
    builder: SceneBuilder, places: Places, radius: float, rng: np.random.Generator
) -> None:
    for index, size in enumerate(((0.5, 0.36, 0.32), (0.3, 0.3, 0.26))):
        place = places.find((-radius, -radius), (radius, radius), 0.5 * size[0] + 0.05, radius)
        if place is None:
            continue
        height = float(builder.terrain.height(place)) + 0.42 * size[2]
        pose = upright(*place, height, float(rng.uniform(-np.pi, np.pi)))
        builder.add_box(f"case_{index}", size, pose, "crate")


def _add_rocks(
    builder: SceneBuilder, places: Places, config: MarsConfig, rng: np.random.Generator
) -> None:
    radius = 0.5 * config.size
    corner = (radius, radius)
    for index in range(config.boulders):
        extent = 0.25 * (0.8 / 0.25) ** float(rng.uniform())
        place = places.find((-radius, -radius), corner, 0.55 * extent, radius + 0.1)
        if place is not None:
            add_boulder(builder, f"boulder_{index}", place, extent, rng)
    for index in range(config.stones):
        distance, bearing = radius * np.sqrt(rng.uniform()), rng.uniform(-np.pi, np.pi)
        where = (float(distance * np.cos(bearing)), float(distance * np.sin(bearing)))
        if distance > 0.5:
            add_boulder(builder, f"stone_{index}", where, float(rng.uniform(0.02, 0.05)), rng, 2)


_CAVE_GAP = 0.9  # [m] between things, for a rover of 0.4 m
_MARGIN = 0.8  # [m] of ground beyond the walls
_LAMP = (0.92, 0.90, 0.86)


@dataclass(frozen=True)
class CaveConfig(NaturalGroundConfig):
    """Parameters of the cave."""

    size: float = parameter(6.5, "Mean diameter of the cave", unit="m", low=4.0, high=30.0)
    ceiling: float = parameter(1.7, "Height of the ceiling", unit="m", low=1.2, high=5.0)
    pillars: int = parameter(3, "Number of pillars, as far as they fit", low=0, high=100)
    boulders: int = parameter(5, "Number of boulders on the floor", low=0, high=200)


def cave(config: CaveConfig | None = None, description: str = "") -> World:
    """A cave without an exit; the robot starts in its middle and lights it.

    Args:
        config: the parameters.
        description: URDF text of a robot to put in; empty for none.
    """
    config = config or CaveConfig()
    rng, look = (np.random.default_rng(s) for s in np.random.SeedSequence(config.seed).spawn(2))
    phases = rng.uniform(0.0, 2.0 * np.pi, 3)
    half = 0.62 * config.size + _MARGIN
    n = node_count(config, half)
    floor = uneven_floor(config, n, rng)
    builder = SceneBuilder(bounded_terrain(half, floor, np.full((n, n), -1.0), 0.0, 1.0))
    builder.sun, builder.ambient = False, _LAMP
    radius = 0.62 * config.size
    builder.region = np.array([(-radius, -radius, -0.3), (radius, radius, config.ceiling + 0.1)])
    _add_rock_materials(builder, config.texture_size, look)
    builder.add_terrain("ground")
    _add_walls(builder, config, phases, rng)
    _add_ceiling(builder, config, rng)
    _add_inside(builder, config, phases, rng)
    if description:
        builder.add_robot(description, "paint")
    return builder.compile()


def _add_rock_materials(builder: SceneBuilder, size: int, rng: np.random.Generator) -> None:
    small = max(64, size // 4)
    builder.add_ground_material("ground", textures.ground(size, rng), tile=2.6)
    for index, tint in enumerate(((1.0, 0.9, 0.8), (0.86, 0.86, 0.9), (1.1, 0.95, 0.8))):
        builder.add_material(f"rock_{index}", textures.rock(small, rng, tint))
    builder.add_material("paint", textures.worn_paint(small, rng))


def _wall_radius(config: CaveConfig, phases: np.ndarray, bearing: float) -> float:
    """Distance of the wall from the middle in a direction [rad] -> [m]."""
    waves = 0.12 * np.sin(2 * bearing + phases[0]) + 0.08 * np.sin(3 * bearing + phases[1])
    return float(0.5 * config.size * (1.0 + waves + 0.04 * np.sin(5 * bearing + phases[2])))


def _add_walls(
    builder: SceneBuilder, config: CaveConfig, phases: np.ndarray, rng: np.random.Generator
) -> None:
    """Rocks beside and above each other, so near that nothing is seen between them."""
    count = round(np.pi * config.size / 0.5)
    layers = max(2, round(config.ceiling / 0.45))
    for layer in range(layers):
        height = config.ceiling * layer / (layers - 1)
        for index in range(count):
            bearing = 2.0 * np.pi * (index + 0.5 * (layer % 2)) / count
            distance = _wall_radius(config, phases, bearing) + 0.4
            place = distance * np.cos(bearing), distance * np.sin(bearing), height
            size = rng.uniform((0.95, 1.15, 1.15), (1.1, 1.4, 1.4))
            mesh = boulder((size[0], size[1], size[2]), rng, 3)
            name = f"wall_{layer}_{index}"
            builder.add_mesh(name, *mesh, upright(*place, bearing), f"rock_{rng.integers(3)}")


def _add_ceiling(builder: SceneBuilder, config: CaveConfig, rng: np.random.Generator) -> None:
    """Flat rocks on a grid that overlap."""
    reach = 0.62 * config.size + 0.4
    axis = np.arange(-reach, reach + 0.75, 0.75)
    for index, (x, y) in enumerate((x, y) for x in axis for y in axis if np.hypot(x, y) < reach):
        size = rng.uniform((1.5, 1.5, 0.45), (1.8, 1.8, 0.6))
        mesh = boulder((size[0], size[1], size[2]), rng, 3)
        height = config.ceiling + 0.18 + float(rng.uniform(-0.04, 0.04))
        pose = upright(float(x), float(y), height, float(rng.uniform(-np.pi, np.pi)))
        builder.add_mesh(f"ceiling_{index}", *mesh, pose, f"rock_{rng.integers(3)}")


def _add_inside(
    builder: SceneBuilder, config: CaveConfig, phases: np.ndarray, rng: np.random.Generator
) -> None:
    places = Places(rng, _CAVE_GAP)
    places.take(0.0, 0.0, 0.15)
    if config.target_distance:
        stand_board_ahead(builder, places, min(config.target_distance, 0.34 * config.size))
    radius = 0.36 * config.size
    corner = (radius, radius)
    for index in range(config.pillars):
        place = places.find((-radius, -radius), corner, 0.28, radius)
        if place is not None:
            _add_pillar(builder, f"pillar_{index}", place, config.ceiling, rng)
    for index in range(config.boulders):
        extent = float(rng.uniform(0.25, 0.55))
        place = places.find((-radius, -radius), corner, 0.55 * extent, radius)
        if place is not None:
            add_boulder(builder, f"boulder_{index}", place, extent, rng)


def _add_pillar(
    builder: SceneBuilder,
    name: str,
    place: tuple[float, float],
    height: float,
    rng: np.random.Generator,
) -> None:
    """A long rock from the floor into the ceiling."""
    width, depth = (float(value) for value in rng.uniform(0.4, 0.5, 2))
    mesh = boulder((width, depth, 1.5 * height), rng)
    yaw = float(rng.uniform(-np.pi, np.pi))
    pose = upright(*place, 0.5 * height, yaw)
    builder.add_mesh(name, *mesh, pose, f"rock_{rng.integers(3)}")
