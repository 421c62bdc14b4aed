"""The ground that the map shows, as a height per column, with what hangs above it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from infomap_ros.errors import InvalidInputError
from infomap_ros.geometry import float_array
from infomap_ros.geometry.config import check_config, setting
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.mapping.config import LOG_ODDS_QUANTUM
from infomap_ros.mapping.terrain.cubes import drop_specks, gather_cubes, refine_heights
from infomap_ros.mapping.terrain.level import above_ground, grow_level, read_above, read_columns
from infomap_ros.mapping.terrain.measures import fill_holes, largest_steps, plane_misfits
from infomap_ros.mapping.voxel_map import VoxelMap
from infomap_ros.mapping.voxels.window import CONFIRMED_PROBABILITY

GridArray = NDArray[np.float32]

_SQRT_12 = math.sqrt(12.0)


@dataclass(frozen=True)
class TerrainConfig:
    """What counts as ground.

    Raises:
        ConfigError: a value is out of its range.
    """

    resolution: float = setting(
        0.05,
        "Edge of a cell; rounded to whole voxels, at least one.",
        unit="m",
        low=0.001,
        high=1.0,
    )
    radius: float = setting(
        12.0, "Ground is looked for within this square about the robot.", unit="m", low=0.1,
        high=200.0,
    )  # fmt: skip
    min_radius: ClassVar[float] = 1.5
    """The grid reaches at least so far about the robot, seen or not: what stands on its edge
    could not leave it [m].
    """
    below: ClassVar[float] = 3.0
    """Ground is looked for down to this far below the robot [m]."""
    above: ClassVar[float] = 4.0
    """Ground and obstacles are looked for up to this far above the robot [m]."""
    occupied_probability: ClassVar[float] = 0.75
    """A known voxel more likely occupied than this may be ground. Right above a surface voxels get
    some hits and as many misses; one of them would be a step in even ground.
    """
    climb: ClassVar[float] = 0.5
    """Ground farther than this above or below its neighbor is on another level [m]."""
    speck_cells: int = setting(
        2, "Connected groups of at most so many solid cells are taken for noise.", low=0, high=8
    )
    headroom: ClassVar[float] = 0.1
    """What is solid nearer than this above ground belongs to the ground [m]."""
    unknown_gap: float = setting(
        0.2, "Unknown stretches of a column up to this long, between known ones, count as seen.",
        unit="m", low=0.0, high=2.0,
    )  # fmt: skip
    hole_cells: int = setting(
        4, "Holes of at most so many cells are filled where all around agree.", low=0, high=64
    )
    hole_tolerance: ClassVar[float] = 0.02
    """They agree when they lie within this of one plane [m]."""
    roughness_radius: ClassVar[float] = 0.1
    """Half the edge of the cube in which roughness is measured [m]."""

    def __post_init__(self) -> None:
        check_config(self)


@dataclass(frozen=True, eq=False)
class ClosedGround:
    """Ground that a rule closes to the base, whatever the map shows there.

    Attributes:
        where: what lies there, as the end of a sentence: "in or next to keep-out region 'x'".
        cells: of the terrain that are closed, shape (nx, ny).
    """

    where: str
    cells: NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class Terrain:
    """Ground of the robot's level on a grid of square cells, indexed [x, y], shape (nx, ny).

    Attributes:
        heights: z of the supporting surface at the cell's middle [m, map]; NaN where unknown.
        sigma: standard deviation of it [m].
        roughness: root mean square distance in z from the plane that fits the neighborhood,
            without what is higher or lower than it is wide [m].
        step: largest difference in height to a neighboring cell that is sure to be there [m].
        floor: z from which on the column is open [m, map]: a cell's edge above the ground, or
            where that is unknown the lowest open space seen; inf where it is not open.
        overhead: z of the lowest obstacle above `floor` [m, map], inf where there is none.
        seen: z up to which the column above `floor` was seen [m, map].
        origin: x and y of the outer corner of cell (0, 0) [m, map].
        resolution: edge of a cell [m].
        near: the point of the robot about which ground was looked for, shape (3,) [m, map].
        closed: by rules; nothing is open there: `overhead` and `seen` are -inf.
    """

    heights: GridArray
    sigma: GridArray
    roughness: GridArray
    step: GridArray
    floor: GridArray
    overhead: GridArray
    seen: GridArray
    origin: tuple[float, float]
    resolution: float
    near: tuple[float, float, float]
    closed: tuple[ClosedGround, ...] = ()

    def closed_at(self, points: ArrayLike) -> str:
        """What closes the ground at the first of points, shape (N, 2 or more), that is closed.

        Empty where none is.
        """
        cells = self.cells_of(np.atleast_2d(points))
        cells = cells[((cells >= 0) & (cells < self.heights.shape)).all(axis=1)]
        for ground in self.closed:
            if ground.cells[tuple(cells.T)].any():
                return ground.where
        return ""

    def cells_of(self, points: ArrayLike) -> NDArray[np.int64]:
        """Cells that hold points, shape (..., 2 or more) [m, map] -> (..., 2); may be outside."""
        xy = np.asarray(points, dtype=np.float64)[..., :2]
        return np.floor((xy - self.origin) / self.resolution).astype(np.int64)

    def centers_of(self, cells: ArrayLike) -> FloatArray:
        """Middles of cells, shape (..., 2) -> (..., 2) [m, map]."""
        return np.asarray((np.asarray(cells) + 0.5) * self.resolution + self.origin)

    def height_at(self, points: ArrayLike) -> FloatArray:
        """Height of the cells that hold points, shape (..., 2) -> (...) [m, map]; NaN outside."""
        cells = self.cells_of(points)
        inside = np.asarray(((cells >= 0) & (cells < self.heights.shape)).all(axis=-1))
        i, j = np.moveaxis(np.where(inside[..., None], cells, 0), -1, 0)
        return np.where(inside, self.heights[i, j].astype(np.float64), np.nan)


def terrain_of(voxel_map: VoxelMap, config: TerrainConfig | None, near: ArrayLike) -> Terrain:
    """Find the ground of the robot's level.

    Args:
        voxel_map: the map.
        config: what counts as ground; None for the defaults.
        near: a point of the robot, for example its base, shape (3,) [m, map]: the ground there is
            the highest surface that is not above it.

    Raises:
        InvalidInputError: `near` is not a finite point.
    """
    settings = config or TerrainConfig()
    point = float_array(near, "near")
    if point.shape != (3,) or not np.isfinite(point).all():
        raise InvalidInputError("near", f"is {point.tolist()}, expected a finite point")
    size = voxel_map.config.voxel_size
    ratio = max(1, round(settings.resolution / size))
    edge = ratio * size
    first, shape = _box(voxel_map, settings, point, ratio)
    cubes = np.zeros(shape, np.uint8)
    blocks, gaussians = voxel_map._storage.blocks, voxel_map._storage.gaussians
    occupied, confirmed = (
        math.log(p / (1.0 - p)) / LOG_ODDS_QUANTUM
        for p in (settings.occupied_probability, CONFIRMED_PROBABILITY)
    )
    gather_cubes(blocks, first, ratio, occupied, confirmed, cubes)
    drop_specks(cubes, settings.speck_cells)
    top, level = np.empty(shape[:2], np.int64), np.empty(shape[:2], np.int64)
    seed = np.clip(np.floor(point / edge).astype(np.int64) - first, 0, np.array(shape) - 1)
    lengths = settings.headroom, settings.unknown_gap, settings.climb
    headroom, gap, climb = (math.ceil(x / edge - 1e-9) for x in lengths)
    grow_level(cubes, seed, headroom, gap, climb, top, level)
    heights = np.where(top >= 0, (top + first[2] + 0.5) * edge, np.nan)
    sigmas = np.where(top >= 0, edge / _SQRT_12, np.nan)
    refine_heights(blocks, gaussians, size, first, ratio, cubes, top, heights, sigmas)
    return _measured(
        cubes, top, level, headroom, gap, heights, sigmas, first, edge, settings, point
    )


def _box(
    voxel_map: VoxelMap, config: TerrainConfig, near: FloatArray, ratio: int
) -> tuple[NDArray[np.int64], tuple[int, int, int]]:
    """First cube and number of cubes of what is looked at, never empty."""
    edge = ratio * voxel_map.config.voxel_size
    reach = np.array([config.radius, config.radius, config.below])
    first = np.floor((near - reach) / edge).astype(np.int64)
    reach[2] = config.above
    last = np.floor((near + reach) / edge).astype(np.int64)
    least = np.array([config.min_radius, config.min_radius, 0.0])
    low = np.floor((near - least) / edge).astype(np.int64)
    high = np.floor((near + least) / edge).astype(np.int64)
    bounds = voxel_map.bounds()
    if bounds is not None:
        low = np.minimum(low, bounds[0] // ratio - 1)
        high = np.maximum(high, bounds[1] // ratio + 1)
    first, last = np.maximum(first, low), np.minimum(last, high)
    nx, ny, nz = (int(n) for n in last - first + 1)
    return first, (nx, ny, nz)


def _measured(
    cubes: NDArray[np.uint8], top: NDArray[np.int64], level: NDArray[np.int64],
    headroom: int, gap: int, heights: FloatArray, sigmas: FloatArray, first: NDArray[np.int64],
    edge: float, config: TerrainConfig, near: FloatArray,
) -> Terrain:  # fmt: skip
    """Read the columns above the ground, fill its holes, and measure it."""
    shape, nz, bottom = top.shape, cubes.shape[2], first[2]
    floor, overhead, seen = (np.empty(shape, np.int64) for _ in range(3))
    pit, filled = np.empty(shape, np.bool_), np.empty(shape, np.bool_)
    read_columns(cubes, top, level, gap, floor, overhead, seen, pit)
    fill_holes(heights, sigmas, pit, config.hole_cells, config.hole_tolerance, filled)
    for i, j in np.argwhere(filled):
        floor[i, j] = above_ground(cubes, i, j, int(heights[i, j] / edge - first[2]), headroom)
        overhead[i, j], seen[i, j] = read_above(cubes, i, j, floor[i, j], gap)
    steps, roughness = np.empty(shape), np.empty(shape)
    largest_steps(heights, sigmas, steps)
    reach = max(1, round(config.roughness_radius / edge))
    plane_misfits(heights, reach, max(config.roughness_radius, edge), roughness)
    return Terrain(
        heights=heights.astype(np.float32),
        sigma=sigmas.astype(np.float32),
        roughness=roughness.astype(np.float32),
        step=steps.astype(np.float32),
        floor=np.where(floor >= nz, np.inf, (floor + bottom) * edge).astype(np.float32),
        overhead=np.where(overhead > nz, np.inf, (overhead + bottom) * edge).astype(np.float32),
        seen=((seen + bottom) * edge).astype(np.float32),
        origin=(float(first[0] * edge), float(first[1] * edge)),
        resolution=edge,
        near=(float(near[0]), float(near[1]), float(near[2])),
    )
