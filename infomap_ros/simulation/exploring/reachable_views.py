"""Where a robot can stand and hold its camera in a true world, found without any map."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from infomap_ros.errors import SimulationError
from infomap_ros.geometry.config import check_config, parameter
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.simulation.worlds.builder import World

_GRID = 0.05  # [m] of the raster in which obstacles are looked for
_LEVELS = 5  # heights at which the faces of obstacles are looked for


@dataclass(frozen=True)
class ReachableViewsConfig:
    """What a robot can do; the defaults are cautious for ``config/rover.urdf``."""

    footprint_radius: float = parameter(
        0.32, "Radius about the base that must be free.", unit="m", low=0.0, high=5.0
    )
    step_height: float = parameter(
        0.06,
        "What is lower than this above the ground is no obstacle.",
        unit="m",
        low=0.0,
        high=1.0,
    )
    head_room: float = parameter(
        1.1, "Obstacles are looked for up to this height.", unit="m", low=0.1, high=5.0
    )
    max_slope: float = parameter(0.35, "Steepest ground.", unit="rad", low=0.0, high=1.5)
    camera_heights: tuple[float, ...] = parameter(
        (0.35, 0.6, 0.85), "Heights of the camera above the ground.", unit="m", low=0.0, high=10.0
    )
    camera_reach: float = parameter(
        0.3, "How far beside the base the camera can be held.", unit="m", low=0.0, high=5.0
    )
    camera_clearance: float = parameter(
        0.12, "Distance that the camera keeps from everything.", unit="m", low=0.0, high=5.0
    )
    spacing: float = parameter(
        0.3, "Distance of neighboring base places.", unit="m", low=0.05, high=5.0
    )
    max_cameras: int = parameter(
        800, "Of more camera positions so many are kept, by chance.", low=1, high=1000000
    )
    seed: int = parameter(1, "Seed of that chance.", low=0)

    def __post_init__(self) -> None:
        """Validate all fields."""
        check_config(self)


def standable_places(world: World, config: ReachableViewsConfig | None = None) -> FloatArray:
    """Places where the base can stand, connected with the start.

    Args:
        world: the true world; its region bounds the places.
        config: the parameters.

    Returns:
        Points on the ground, shape (N, 3) [m].

    Raises:
        SimulationError: the region has no bounds, or the start itself is not free.
    """
    config = config or ReachableViewsConfig()
    x, y = _axes(world, config.footprint_radius + 0.3)
    grid = np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1)
    ground = world.terrain.height(grid)
    reached = _connected(world, _free(world, grid, ground, config), x, y)
    every = max(1, round(config.spacing / _GRID))
    kept = np.zeros_like(reached)
    kept[::every, ::every] = True
    kept &= ((grid >= world.region[0, :2]) & (grid <= world.region[1, :2])).all(axis=-1)
    places = np.concatenate([grid, ground[..., None]], axis=-1)
    return np.asarray(places[reached & kept])


def reachable_cameras(world: World, config: ReachableViewsConfig | None = None) -> FloatArray:
    """Positions where the camera can be held: above the standable places and beside them.

    Args:
        world: the true world.
        config: the parameters.

    Returns:
        shape (M, 3) [m].

    Raises:
        SimulationError: as `standable_places`.
    """
    config = config or ReachableViewsConfig()
    places = standable_places(world, config)
    bearings = np.linspace(0.0, 2.0 * np.pi, 6, endpoint=False)
    ring = config.camera_reach * np.column_stack([np.cos(bearings), np.sin(bearings)])
    found = []
    for height in config.camera_heights:
        middle = places + np.array((0.0, 0.0, height))
        middle = middle[_sees(world, places + np.array((0.0, 0.0, 0.1)), middle)]
        found.append(middle)
        for offset in ring if config.camera_reach > 0.0 else ():
            beside = middle + np.append(offset, 0.0)
            found.append(beside[_sees(world, middle, beside)])
    cameras = np.concatenate(found)
    cameras = cameras[world.surface_distance(cameras) > config.camera_clearance]
    chosen = np.random.default_rng(config.seed).permutation(len(cameras))[: config.max_cameras]
    return cameras[np.sort(chosen)]


def _axes(world: World, margin: float) -> tuple[FloatArray, FloatArray]:
    low, high = world.region
    if not np.isfinite(world.region).all():
        raise SimulationError("the world has no bounded region to be explored")
    x, y = (np.arange(low[k] - margin, high[k] + margin, _GRID) for k in range(2))
    return x, y


def _free(
    world: World, grid: FloatArray, ground: FloatArray, config: ReachableViewsConfig
) -> NDArray[np.bool_]:
    """Cells over which no obstacle is and whose ground is not too steep, footprint included."""
    blocked = np.zeros(ground.shape, dtype=bool)
    levels = np.linspace(config.step_height, config.head_room, _LEVELS)
    layers = [np.concatenate([grid, ground[..., None] + z], axis=-1) for z in levels]
    blocked |= ~_sees(world, layers[-1].reshape(-1, 3), layers[0].reshape(-1, 3)).reshape(
        ground.shape
    )
    for layer in layers:  # the faces of what is higher than the robot
        for axis in (0, 1):
            beside = layer + 0.5 * _GRID * np.eye(3)[axis]
            before = layer - 0.5 * _GRID * np.eye(3)[axis]
            free = _sees(world, before.reshape(-1, 3), beside.reshape(-1, 3))
            blocked |= ~free.reshape(ground.shape)
    smooth = ndimage.gaussian_filter(ground, config.footprint_radius / (2.0 * _GRID))
    slope = np.hypot(*np.gradient(smooth, _GRID))
    blocked |= slope > np.tan(config.max_slope)
    return np.asarray(ndimage.distance_transform_edt(~blocked) * _GRID > config.footprint_radius)


def _connected(
    world: World, free: NDArray[np.bool_], x: FloatArray, y: FloatArray
) -> NDArray[np.bool_]:
    labels, _ = ndimage.label(free)
    start = labels[np.argmin(np.abs(x - world.start[0])), np.argmin(np.abs(y - world.start[1]))]
    if start == 0:
        raise SimulationError("the robot cannot stand at the world's start")
    return np.asarray(labels == start)


def _sees(world: World, origins: FloatArray, ends: FloatArray) -> NDArray[np.bool_]:
    return np.isinf(world.surface.first_hits(origins, ends))
