"""A planar world: a grid of free and occupied cells, seen through a `VoxelMap` of one layer.

The range sensor of the planar experiments: a fan of rays without noise.

Seeded planar worlds of 100 x 100 m: clutter, rooms, caves, and one like that of Fig. 10.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from infomap_ros.errors import ConfigError, InvalidInputError
from infomap_ros.geometry import PinholeCamera, make_transform
from infomap_ros.geometry.config import check_config, parameter
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.mapping import VoxelMap, VoxelMapConfig
from infomap_ros.mapping.voxels.state import put_states, unknown_states
from infomap_ros.views.information.view_query import camera_rays
from infomap_ros.views.sampling.orientations import look_rotations

BoolArray = NDArray[np.bool_]

_CERTAIN = 20  # evidence of the true map [quanta]


@dataclass(frozen=True, eq=False)
class PlanarWorld:
    """What is to be explored.

    Attributes:
        name: for tables and files.
        kind: worlds of one kind are averaged.
        occupied: shape (nx, ny), bool; cell (i, j) spans from (i, j) to (i + 1, j + 1) cells. All
            around lies a wall one cell thick that is part of the grid.
        cell: edge of a cell [m].
        start: where the sensor starts, shape (2,) [m]; in a free cell.

    Raises:
        InvalidInputError: the border is open, or the start is not free.
    """

    name: str
    kind: str
    occupied: BoolArray
    cell: float
    start: FloatArray

    def __post_init__(self) -> None:
        grid = self.occupied
        border = np.concatenate([grid[0], grid[-1], grid[:, 0], grid[:, -1]])
        if not border.all():
            raise InvalidInputError("planar world", f"{self.name}: its border is not a wall")
        if grid[self.start_cell]:
            raise InvalidInputError("planar world", f"{self.name}: it starts in an obstacle")

    @property
    def start_cell(self) -> tuple[int, int]:
        """Cell of the start."""
        i, j = np.floor(np.asarray(self.start) / self.cell).astype(int)
        return int(i), int(j)

    @property
    def size(self) -> FloatArray:
        """Edges of the grid, shape (2,) [m]."""
        return np.array(self.occupied.shape) * self.cell

    @cached_property
    def mappable(self) -> BoolArray:
        """Cells that can be mapped from where the sensor can come to, shape (nx, ny).

        The free cells that are connected with the start over their edges, and the occupied ones
        that share an edge with them. Only these count in the fraction mapped.
        """
        labels, _ = ndimage.label(~self.occupied)
        free = labels == labels[self.start_cell]
        return np.asarray(free | (ndimage.binary_dilation(free) & self.occupied))

    @cached_property
    def truth(self) -> VoxelMap:
        """The occupied cells as a map of one layer, from which scans are taken."""
        cells = np.argwhere(self.occupied)
        indices = np.column_stack([cells, np.zeros(len(cells), int)]).astype(np.int32)
        voxel_map = VoxelMap(VoxelMapConfig(voxel_size=self.cell))
        states = unknown_states(indices)
        states.known[:] = True
        states.quanta[:] = _CERTAIN
        put_states(voxel_map._storage, states)
        return voxel_map

    def known_cells(self, voxel_map: VoxelMap) -> BoolArray:
        """Which cells a map knows, shape (nx, ny)."""
        centers = np.argwhere(np.ones(self.occupied.shape, np.bool_)) + 0.5
        places = np.column_stack([centers, np.full(len(centers), 0.5)]) * self.cell
        return voxel_map.is_known(places).reshape(self.occupied.shape)

    def fraction_mapped(self, voxel_map: VoxelMap) -> float:
        """Share of the mappable cells that a map knows, in [0, 1]."""
        known = self.known_cells(voxel_map)
        return float(np.count_nonzero(known & self.mappable) / np.count_nonzero(self.mappable))


_INSIDE = 0.02  # a hit is put so far into its voxel [voxels]
_COLUMNS = 128  # of the camera whose opening the sensor has
_THIN = 1e-3  # its opening across the plane [rad]


@dataclass(frozen=True)
class SensorConfig:
    """A planar range sensor.

    Raises:
        ConfigError: a value is out of its range.
    """

    field_of_view: float = parameter(90.0, "Opening.", unit="deg", low=1.0, high=170.0)
    max_range: float = parameter(15.0, "Depth of field.", unit="m", low=0.1, high=1000.0)
    ray_spacing: float = parameter(
        0.0125, "Largest angle between neighboring rays.", unit="rad", low=1e-4, high=0.1
    )

    def __post_init__(self) -> None:
        check_config(self)

    @cached_property
    def camera(self) -> PinholeCamera:
        """A camera of one row with that opening."""
        focal = 0.5 * _COLUMNS / math.tan(math.radians(0.5 * self.field_of_view))
        return PinholeCamera(_COLUMNS, 1, focal, 1.0 / _THIN, 0.5 * _COLUMNS - 0.5, 0.0)

    def map_config(self, cell: float) -> VoxelMapConfig:
        """A map of what the sensor sees: without noise, one look makes a voxel free or occupied."""
        return VoxelMapConfig(
            voxel_size=cell,
            max_range=self.max_range,
            probability_hit=0.97,
            probability_miss=0.04,
            association_sigmas=0.0,
            free_gap=0.0,
            error_correlation=0.0,
            default_sigma=1e-3 * cell,
        )


def level_pose(place: FloatArray, azimuth: float, cell: float) -> FloatArray:
    """``T_map_camera`` at a place, shape (2,) [m], in the middle of the layer of voxels."""
    rotation = look_rotations(np.array([azimuth]), np.zeros(1))[0]
    return make_transform(rotation, np.array([place[0], place[1], 0.5 * cell]))


def take_scan(
    truth: VoxelMap, sensor: SensorConfig, T_map_camera: FloatArray, voxel_map: VoxelMap
) -> None:
    """Measure the true map and add the scan to another one.

    Args:
        truth: see `PlanarWorld.truth`.
        sensor: that measures.
        T_map_camera: from where, shape (4, 4).
        voxel_map: receives the scan.
    """
    rays, _ = camera_rays(sensor.camera, sensor.ray_spacing, planar=True)
    directions = rays @ T_map_camera[:3, :3].T
    distances, hits = truth.first_occupied(T_map_camera[:3, 3], directions, sensor.max_range)
    beyond = 2.0 * sensor.max_range
    lengths = np.where(hits, distances + _INSIDE * truth.config.voxel_size, beyond)
    voxel_map.integrate(rays * lengths[:, None], T_map_camera)


_SIDE = 100.0  # [m]
_CLEAR = 3.0  # radius about the start without obstacles [m]
_LEAST_OPEN = 0.35  # share of a world that can be entered, else it is drawn again

Draw = Callable[[np.random.Generator, int, float], BoolArray]


def clutter(rng: np.random.Generator, side: int, cell: float) -> BoolArray:
    """Discs and turned boxes of 1 to 6 m until they cover a seventh of the ground."""
    x, y = np.meshgrid(*[(np.arange(side) + 0.5) * cell] * 2, indexing="ij")
    occupied = np.zeros((side, side), np.bool_)
    while occupied.mean() < 1.0 / 7.0:
        middle, angle = rng.uniform(0.0, side * cell, 2), rng.uniform(0.0, np.pi)
        half = rng.uniform(0.5, 3.0, 2)
        dx, dy = x - middle[0], y - middle[1]
        u = dx * np.cos(angle) + dy * np.sin(angle)
        v = dy * np.cos(angle) - dx * np.sin(angle)
        is_disc = rng.random() < 0.5
        box = (np.abs(u) < half[0]) & (np.abs(v) < half[1])
        occupied |= np.hypot(u, v) < half[0] if is_disc else box
    return occupied


def rooms(rng: np.random.Generator, side: int, cell: float) -> BoolArray:
    """Rooms that are cut out of the whole, and out of each other, by walls with doors."""
    occupied = np.zeros((side, side), np.bool_)
    wall, least, door = (max(1, round(width / cell)) for width in (0.5, 10.0, 2.0))
    parts = [(0, 0, side, side)]
    while parts:
        left, low, right, high = parts.pop()
        across = (right - left) >= (high - low)
        first, last = (left, right) if across else (low, high)
        if last - first < 2 * least + wall or (last - first < 3 * least and rng.random() < 0.2):
            continue
        at = int(rng.integers(first + least, last - least - wall + 1))
        begin, end = (low, high) if across else (left, right)
        line = np.ones(end - begin, np.bool_)
        for part in np.array_split(np.arange(end - begin), max(1, (end - begin) // (4 * least))):
            gap = int(rng.integers(part[0] + wall, part[-1] - door - wall + 1))
            line[gap : gap + door] = False
        if across:
            occupied[at : at + wall, begin:end] |= line
            parts += [(left, low, at, high), (at + wall, low, right, high)]
        else:
            occupied[begin:end, at : at + wall] |= line[:, None]
            parts += [(left, low, right, at), (left, at + wall, right, high)]
    return occupied


def caves(rng: np.random.Generator, side: int, cell: float) -> BoolArray:
    """Noise, smoothed over 2.5 m and cut so that two fifths are rock."""
    noise = ndimage.gaussian_filter(rng.normal(size=(side, side)), 2.5 / cell, mode="wrap")
    return np.asarray(noise > np.quantile(noise, 0.6))


def unstructured(rng: np.random.Generator, side: int, cell: float) -> BoolArray:
    """Rugged islands of 3 to 15 m: the kind of world that Fig. 10 shows."""
    noise = ndimage.gaussian_filter(rng.normal(size=(side, side)), 4.0 / cell, mode="wrap")
    rugged = ndimage.gaussian_filter(rng.normal(size=(side, side)), 1.0 / cell, mode="wrap")
    noise = noise / noise.std() + 0.35 * rugged / rugged.std()
    return np.asarray(noise > np.quantile(noise, 0.8))


KINDS: Mapping[str, Draw] = {
    "fig10": unstructured,
    "clutter": clutter,
    "rooms": rooms,
    "caves": caves,
}
"""Kinds of worlds by name."""


def make_world(kind: str, seed: int, cell: float = 0.5) -> PlanarWorld:
    """Draw a world; the sensor starts in its middle.

    Args:
        kind: one of `KINDS`.
        seed: of the random numbers; a draw of which less than a third can be entered is repeated.
        cell: edge of a cell [m].

    Raises:
        ConfigError: there is no such kind.
    """
    if kind not in KINDS:
        raise ConfigError("kind", kind, "one of " + ", ".join(KINDS))
    rng = np.random.default_rng([seed, *kind.encode()])
    side = round(_SIDE / cell)
    place = (np.arange(side) + 0.5) * cell - 0.5 * _SIDE
    clear = np.hypot(place[:, None], place) < _CLEAR
    while True:
        occupied = np.pad(KINDS[kind](rng, side, cell) & ~clear, 1, constant_values=True)
        start = (np.array([side // 2 + 1, side // 2 + 1]) + 0.5) * cell
        world = PlanarWorld(f"{kind}_{seed}", kind, occupied, cell, start)
        if np.mean(world.mappable & ~occupied) > _LEAST_OPEN:
            return world
