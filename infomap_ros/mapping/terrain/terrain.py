"""The ground that the map shows, as a height per column, with what hangs above it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray

from infomap_ros.errors import InvalidInputError
from infomap_ros.geometry import float_array
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.mapping.config import LOG_ODDS_QUANTUM
from infomap_ros.mapping.terrain import measures
from infomap_ros.mapping.terrain.measures import (
    OPEN,
    SOLID,
    SUSPECT,
    drop_specks,
    gather_cubes,
    refine_heights,
)
from infomap_ros.mapping.voxel_map import VoxelMap
from infomap_ros.mapping.voxels.window import CONFIRMED_PROBABILITY

# Which of the surfaces in a column of the map is the ground of the robot's level.
#
# The ground grows from the robot outwards, always next where it changes least (Prim's order), and
# takes in each column the surface nearest to the height of the neighbor from which it came, if it
# is not far above or below it. So it follows ramps under ceilings and floors under tables, and a
# ceiling under which no floor was seen is none.

_GRAZED = 2  # cubes from the neighbor's ground to a surface above which nothing was seen
_SLOPE = 0.5  # of ground above which nothing was seen, from the robot
_UNKNOWN_COST = 2  # cubes of height change that growing across a column without ground counts as


@njit(cache=True, nogil=True)
def grow_level(
    cubes: Any, seed: Any, headroom: int, gap: int, climb: int, top: Any, level: Any
) -> None:
    """Find the ground of every column.

    Args:
        cubes: states, shape (nx, ny, nz).
        seed: cube of the robot's base or its ground, shape (3,): the ground there is the highest
            surface that is not above it.
        headroom: cubes above a surface that must not be solid.
        gap: unknown cubes above a surface that are tolerated.
        climb: cubes between the ground of neighbors; what is farther is another level.
        top: receives the uppermost cube of the ground, -1 where there is none, shape (nx, ny).
        level: receives the height at which ground was looked for [cubes], shape (nx, ny).
    """
    nx, ny, nz = cubes.shape
    top[:], level[:] = -1, -1
    starts, surfaces, climbs = _list_surfaces(cubes, seed, headroom, gap, climb)
    capacity = 4 * nx * ny + 1
    cells, tops = np.empty(capacity, np.int64), np.empty(capacity, np.int64)
    levels, following = np.empty(capacity, np.int64), np.empty(capacity, np.int64)
    buckets = np.full(nz + 1, -1, np.int64)
    anchored = np.zeros(nx * ny, np.bool_)
    cells[0], levels[0], following[0] = seed[0] * ny + seed[1], seed[2], -1
    tops[0] = _surface_below(starts, surfaces, cells[0], seed[2], climbs[cells[0]])
    buckets[0], count, lowest = 0, 1, 0
    while lowest <= nz:
        entry = buckets[lowest]
        if entry < 0:
            lowest += 1
            continue
        buckets[lowest] = following[entry]
        cell = cells[entry]
        i, j = cell // ny, cell % ny
        if level[i, j] >= 0:
            continue
        top[i, j] = tops[entry]
        here = tops[entry] if tops[entry] >= 0 else levels[entry]
        level[i, j] = here
        anchored[cell] = anchored[cell] or tops[entry] >= 0
        for side in range(4):
            a, b = i + (side == 0) - (side == 1), j + (side == 2) - (side == 3)
            if not (0 <= a < nx and 0 <= b < ny) or level[a, b] >= 0:
                continue
            other = a * ny + b
            if anchored[cell]:
                anchored[other] = True
                surface = _surface_near(starts, surfaces, other, here, climbs[other])
            else:
                surface = _surface_below(starts, surfaces, other, here, climbs[other])
            cost = min(abs(surface - here), nz) if surface >= 0 else _UNKNOWN_COST
            cells[count], tops[count], levels[count] = other, surface, here
            following[count] = buckets[cost]
            buckets[cost] = count
            count += 1
            lowest = min(lowest, cost)


@njit(cache=True, nogil=True)
def _list_surfaces(cubes: Any, seed: Any, headroom: int, gap: int, climb: int) -> Any:
    """Where each column's surfaces begin, their uppermost cubes, upwards, and how far they may be.

    What was hit once is ground only where nothing else is: else it is noise above it. Where nothing
    was seen above, as above a floor at a grazing angle, only what continues the neighbor's ground
    is, and a slope from the robot reaches: else ground grew along a vault's walls onto its ceiling.
    """
    nx, ny, nz = cubes.shape
    climbs = np.full(nx * ny, climb, np.int64)
    starts = np.zeros(nx * ny + 1, np.int64)
    surfaces = np.empty(nx * ny, np.int64)
    count = 0
    for cell in range(nx * ny):
        i, j = cell // ny, cell % ny
        highest = seed[2] + climb + int(_SLOPE * math.hypot(i - seed[0], j - seed[1]))
        if count + nz > len(surfaces):
            surfaces = np.append(surfaces, np.empty(len(surfaces) + nz, np.int64))
        for weakest, is_open in ((SOLID, True), (SUSPECT, True), (SOLID, False)):
            for k in range(nz - 1 if is_open else min(nz - 1, highest + 1)):
                if cubes[i, j, k] >= weakest and _is_surface_top(
                    cubes, i, j, k, headroom, gap, weakest, is_open
                ):
                    surfaces[count] = k
                    count += 1
            if count > starts[cell]:
                climbs[cell] = climb if is_open else min(climb, _GRAZED)
                break
        starts[cell + 1] = count
    return starts, surfaces, climbs


@njit(cache=True, nogil=True)
def _is_surface_top(
    cubes: Any, i: int, j: int, k: int, headroom: int, gap: int, weakest: int, is_open: bool
) -> bool:
    """Whether the cubes above cube k are no surface themselves, and seen open where asked for."""
    seen = not is_open
    for h in range(1, min(max(headroom, gap + 1), cubes.shape[2] - 1 - k) + 1):
        state = cubes[i, j, k + h]
        if h <= headroom and state >= weakest:
            return False
        if h <= gap + 1 and state == OPEN:
            seen = True
    return seen


@njit(cache=True, nogil=True)
def _surface_near(starts: Any, surfaces: Any, cell: int, level: int, climb: int) -> int:
    """Surface of a column nearest to a level, of two as near the lower; -1 for none near."""
    best = -1
    for n in range(starts[cell], starts[cell + 1]):
        if best < 0 or abs(surfaces[n] - level) < abs(best - level):
            best = surfaces[n]
    return best if abs(best - level) <= climb else -1


@njit(cache=True, nogil=True)
def _surface_below(starts: Any, surfaces: Any, cell: int, level: int, climb: int) -> int:
    """Highest surface of a column not above a level, else the lowest above it; -1 for none near."""
    best = -1
    for n in range(starts[cell], starts[cell + 1]):
        if best < 0 or surfaces[n] <= level:
            best = surfaces[n]
    return best if best <= level + climb else -1


@njit(cache=True, nogil=True)
def read_columns(
    cubes: Any, top: Any, level: Any, gap: int, floor: Any, overhead: Any, seen: Any, pit: Any
) -> None:
    """Read above the ground of each column, in cubes from the array's bottom.

    Args:
        cubes: states, shape (nx, ny, nz).
        top: uppermost cube of the ground, -1 where there is none, shape (nx, ny).
        level: where ground was looked for [cubes], shape (nx, ny).
        gap: cubes in a row that were not seen through, and count as seen.
        floor: receives the lower end of the open space, nz where there is none, shape (nx, ny).
        overhead: receives the lower end of the first solid cube above, nz + 1 where there is none.
        seen: receives the upper end of what was seen without a gap, shape (nx, ny).
        pit: receives whether a column without ground is no hole in what was seen: open space was
            seen well below the level, or something stands there.
    """
    nx, ny, nz = cubes.shape
    for i in range(nx):
        for j in range(ny):
            bottom = top[i, j] + 1
            pit[i, j] = False
            if top[i, j] < 0:
                bottom = _open_from(cubes, i, j, max(level[i, j], 0))
                deep = level[i, j] - 2
                pit[i, j] = bottom >= nz or (deep >= 0 and cubes[i, j, deep] == OPEN)
            floor[i, j] = bottom
            overhead[i, j], seen[i, j] = read_above(cubes, i, j, bottom, gap)
            if bottom >= nz:
                overhead[i, j], _ = read_above(cubes, i, j, max(level[i, j], 0), gap)


@njit(cache=True, nogil=True)
def _open_from(cubes: Any, i: int, j: int, level: int) -> int:
    """Lowest open cube from a level upwards with nothing solid between, nz for none."""
    nz = cubes.shape[2]
    for k in range(level, nz):
        if cubes[i, j, k] == SOLID:
            return nz
        if cubes[i, j, k] == OPEN:
            return k
    return nz


@njit(cache=True, nogil=True)
def read_above(cubes: Any, i: int, j: int, bottom: int, gap: int) -> tuple[int, int]:
    """First solid cube from `bottom` upwards (nz + 1 for none), and the end of what was seen."""
    nz = cubes.shape[2]
    seen, is_seen = bottom, True
    for k in range(bottom, nz):
        if cubes[i, j, k] == SOLID:
            if is_seen and k - seen <= gap:
                seen = k
            return k, seen
        if is_seen and cubes[i, j, k] == OPEN:
            if k - seen > gap:
                is_seen = False
            else:
                seen = k + 1
    return nz + 1, seen


@njit(cache=True, nogil=True)
def above_ground(cubes: Any, i: int, j: int, ground: int, headroom: int) -> int:
    """First cube above ground in cube `ground` and above what is solid within `headroom` of it."""
    nz = cubes.shape[2]
    bottom = min(max(ground + 1, 0), nz)
    for k in range(bottom, min(bottom + headroom, nz)):
        if cubes[i, j, k] == SOLID:
            bottom = k + 1
    return bottom


GridArray = NDArray[np.float32]

_RESOLUTION = 0.05  # edge of a cell, rounded to whole voxels, at least one [m]
_RADIUS = 12.0  # ground is looked for within this square about the robot [m]
# The grid reaches at least so far about the robot, seen or not: what stands on its edge could not
# leave it [m].
_MIN_RADIUS = 1.5
_BELOW, _ABOVE = 3.0, 4.0  # how far below and above the robot ground is looked for [m]
# A known voxel more likely occupied than this may be ground. Right above a surface voxels get some
# hits and as many misses; one of them would be a step in even ground.
_OCCUPIED_PROBABILITY = 0.75
_CLIMB = 0.5  # ground farther than this above or below its neighbor is on another level [m]
_SPECK_CELLS = 2  # connected groups of at most so many solid cells are taken for noise
_HEADROOM = 0.1  # what is solid nearer than this above ground belongs to the ground [m]
# Unknown stretches of a column up to this long, between known ones, count as seen [m].
_UNKNOWN_GAP = 0.2
# Holes of at most so many cells are filled where all around lies within this of one plane [m].
_HOLE_CELLS, _HOLE_TOLERANCE = 4, 0.02
_ROUGHNESS_RADIUS = 0.1  # half the edge of the cube in which roughness is measured [m]


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
        step: largest difference in height along 0.1 m that is sure to be there [m].
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


def terrain_of(voxel_map: VoxelMap, near: ArrayLike) -> Terrain:
    """Find the ground of the robot's level.

    Args:
        voxel_map: the map.
        near: a point of the robot, for example its base, shape (3,) [m, map]: the ground there is
            the highest surface that is not above it.

    Raises:
        InvalidInputError: `near` is not a finite point.
    """
    point = float_array(near, "near")
    if point.shape != (3,) or not np.isfinite(point).all():
        raise InvalidInputError("near", f"is {point.tolist()}, expected a finite point")
    size = voxel_map.config.voxel_size
    ratio = max(1, round(_RESOLUTION / size))
    edge = ratio * size
    first, shape = _box(voxel_map, point, ratio)
    cubes = np.zeros(shape, np.uint8)
    blocks, gaussians = voxel_map._storage.blocks, voxel_map._storage.gaussians
    occupied, confirmed = (
        math.log(p / (1.0 - p)) / LOG_ODDS_QUANTUM
        for p in (_OCCUPIED_PROBABILITY, CONFIRMED_PROBABILITY)
    )
    gather_cubes(blocks, first, ratio, occupied, confirmed, cubes)
    drop_specks(cubes, _SPECK_CELLS)
    top, level = np.empty(shape[:2], np.int64), np.empty(shape[:2], np.int64)
    seed = np.clip(np.floor(point / edge).astype(np.int64) - first, 0, np.array(shape) - 1)
    lengths = _HEADROOM, _UNKNOWN_GAP, _CLIMB
    headroom, gap, climb = (math.ceil(x / edge - 1e-9) for x in lengths)
    grow_level(cubes, seed, headroom, gap, climb, top, level)
    heights = np.where(top >= 0, (top + first[2] + 0.5) * edge, np.nan)
    sigmas = np.where(top >= 0, measures.CUBE_SIGMA * edge, np.nan)
    refine_heights(blocks, gaussians, size, first, ratio, cubes, top, heights, sigmas)
    return _measured(cubes, top, level, headroom, gap, heights, sigmas, first, edge, point)


def _box(
    voxel_map: VoxelMap, near: FloatArray, ratio: int
) -> tuple[NDArray[np.int64], tuple[int, int, int]]:
    """First cube and number of cubes of what is looked at, never empty."""
    edge = ratio * voxel_map.config.voxel_size
    reach = np.array([_RADIUS, _RADIUS, _BELOW])
    first = np.floor((near - reach) / edge).astype(np.int64)
    reach[2] = _ABOVE
    last = np.floor((near + reach) / edge).astype(np.int64)
    least = np.array([_MIN_RADIUS, _MIN_RADIUS, 0.0])
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
    edge: float, near: FloatArray,
) -> Terrain:  # fmt: skip
    """Read the columns above the ground, fill its holes, and measure it."""
    shape, nz, bottom = top.shape, cubes.shape[2], first[2]
    floor, overhead, seen = (np.empty(shape, np.int64) for _ in range(3))
    pit, filled = np.empty(shape, np.bool_), np.empty(shape, np.bool_)
    read_columns(cubes, top, level, gap, floor, overhead, seen, pit)
    measures.fill_holes(heights, sigmas, pit, _HOLE_CELLS, _HOLE_TOLERANCE, filled)
    for i, j in np.argwhere(filled):
        floor[i, j] = above_ground(cubes, i, j, int(heights[i, j] / edge - first[2]), headroom)
        overhead[i, j], seen[i, j] = read_above(cubes, i, j, floor[i, j], gap)
    steps, roughness = np.empty(shape), np.empty(shape)
    measures.largest_steps(heights, sigmas, edge, steps)
    reach = max(1, round(_ROUGHNESS_RADIUS / edge))
    measures.plane_misfits(heights, reach, max(_ROUGHNESS_RADIUS, edge), roughness)
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
