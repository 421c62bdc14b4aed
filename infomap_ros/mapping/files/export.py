"""A voxel map as files of other programs: point cloud, surface mesh, grid, distances.

The map seen from above, as 2-D planners take it.
"""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from infomap_ros.errors import ConfigError, InvalidInputError
from infomap_ros.geometry.atomic_file import replacing, write_text
from infomap_ros.geometry.config import check_config, parameter, setting
from infomap_ros.mapping import ray_casting
from infomap_ros.mapping.config import LOG_ODDS_QUANTUM
from infomap_ros.mapping.distance_field import distance_field, field_of_blocked
from infomap_ros.mapping.voxel_map import VoxelMap
from infomap_ros.mapping.voxels import window as voxel_window
from infomap_ros.mapping.voxels.block_kernels import quanta_of
from infomap_ros.mapping.voxels.keys import BLOCK_COUNT, BLOCK_SIDE, local_index, pack_all, unpack

UNKNOWN, FREE, OCCUPIED = -1, 0, 100
"""Values of a cell, as in ``nav_msgs/OccupancyGrid``."""

_NOTHING = -(2**31)


@dataclass(frozen=True)
class ProjectionConfig:
    """Which voxels stand in the way.

    Raises:
        ConfigError: a value is out of its range, or the band is empty.
    """

    low: float = parameter(
        0.1, "Lower end of the height band, map frame.", unit="m", low=-1e4, high=1e4
    )
    high: float = parameter(
        1.0, "Upper end of the height band, map frame.", unit="m", low=-1e4, high=1e4
    )
    occupied_probability: float = setting(
        0.65, "A column is occupied if one of its voxels is at least so likely.", low=0.5, high=1.0
    )
    free_probability: float = setting(
        0.25, "A column is free if none of its known voxels is more likely.", low=0.0, high=0.5
    )

    def __post_init__(self) -> None:
        check_config(self)
        if self.high <= self.low:
            raise ConfigError("high", self.high, f"more than low, {self.low} m")


@dataclass(frozen=True, eq=False)
class ProjectedGrid:
    """A grid of square cells, row by row from the lowest y.

    Attributes:
        cells: UNKNOWN, FREE or OCCUPIED, shape (rows along y, columns along x), int8.
        origin: x and y of the outer corner of cell (0, 0), map frame [m].
        resolution: edge of a cell [m].
    """

    cells: NDArray[np.int8]
    origin: tuple[float, float]
    resolution: float


def project_map(voxel_map: VoxelMap, config: ProjectionConfig | None = None) -> ProjectedGrid:
    """Project the voxels of a height band onto the ground plane.

    A column with evidence between the two thresholds is unknown, as are those without any. The
    grid just holds the columns that were observed; an empty map gives one unknown cell.

    Args:
        voxel_map: the map.
        config: height band and thresholds. A voxel belongs to the band with its center.
    """
    band = config or ProjectionConfig()
    size = voxel_map.config.voxel_size
    highest, first = _highest_in_band(voxel_map, band)
    cells = np.full(highest.shape, UNKNOWN, dtype=np.int8)
    known, log_odds = highest > _NOTHING, highest * LOG_ODDS_QUANTUM
    cells[known & (log_odds >= _log_odds(band.occupied_probability))] = OCCUPIED
    cells[known & (log_odds <= _log_odds(band.free_probability))] = FREE
    return ProjectedGrid(cells, (first[0] * size, first[1] * size), size)


def _highest_in_band(
    voxel_map: VoxelMap, band: ProjectionConfig
) -> tuple[NDArray[np.int32], tuple[int, int]]:
    """Most evidence in each column [quanta], rows along y, and x and y index of the first one."""
    bounds = voxel_map.bounds()
    if bounds is None:
        return np.full((1, 1), _NOTHING, np.int32), (0, 0)
    low, high = bounds
    size = voxel_map.config.voxel_size
    levels = np.arange(low[2], high[2] + 1)
    heights = (levels + 0.5) * size
    levels = levels[(heights >= band.low) & (heights <= band.high)]
    highest = np.full((high[1] - low[1] + 1, high[0] - low[0] + 1), _NOTHING, np.int32)
    if len(levels):
        blocks = voxel_map._storage.blocks
        _project(blocks, low[0], low[1], levels[0], levels[-1], highest)
    rows, columns = (np.flatnonzero((highest > _NOTHING).any(axis=axis)) for axis in (1, 0))
    if not len(rows):
        return highest[:1, :1], (0, 0)
    trimmed = highest[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]
    return trimmed, (int(low[0] + columns[0]), int(low[1] + rows[0]))


@njit(cache=True, nogil=True)
def _project(
    blocks: Any, first_x: int, first_y: int, lowest: int, topmost: int, highest: Any
) -> None:
    """Raise the columns to the evidence of the known voxels from level `lowest` to `topmost`."""
    kinds, bases, planes = blocks.kind, blocks.base, blocks.plane
    keys, narrow, wide = blocks.keys, blocks.narrow, blocks.wide
    for slot in range(blocks.counts[BLOCK_COUNT]):
        x, y, z = unpack(keys[slot])
        x, y, z = x * BLOCK_SIDE - first_x, y * BLOCK_SIDE - first_y, z * BLOCK_SIDE
        for level in range(max(z, lowest), min(z + BLOCK_SIDE, topmost + 1)):
            for row in range(BLOCK_SIDE):
                for column in range(BLOCK_SIDE):
                    local = local_index(column, row, level)
                    known, quanta = quanta_of(
                        kinds[slot], bases[slot], planes[slot], narrow, wide, local
                    )
                    if known and quanta > highest[y + row, x + column]:
                        highest[y + row, x + column] = quanta


@dataclass(frozen=True)
class DistanceConfig:
    """Which obstacles `obstacle_distances` measures to, and how far.

    Raises:
        ConfigError: a value is out of its range.
    """

    limit: float = setting(
        2.0, "Distances to obstacles are cut off here.", unit="m", low=0.01, high=1000.0
    )
    margin: float = parameter(
        0.0,
        "Surfaces are as wide as so many of their standard deviations to both sides for "
        "distance_field and distance_slice: 2 or 3 for a planner that keeps no margin itself.",
        low=0.0,
        high=10.0,
    )
    unknown_is_free: bool = setting(
        True,
        "Only what is occupied is an obstacle. Else what is uncertain or was never observed is "
        "one too, as in the file of distances that infomap export writes.",
    )

    def __post_init__(self) -> None:
        check_config(self)


def obstacle_distances(
    voxel_map: VoxelMap, config: DistanceConfig | None = None, band: ProjectionConfig | None = None
) -> NDArray[np.float32]:
    """Distance to the nearest obstacle, for each voxel that was observed.

    Distances are from the centers of voxels to the nearest obstacle's cube, 0 in an obstacle. Holes
    in free space and the voxels right before a surface count as `VoxelWindow.states` says.

    Args:
        voxel_map: the map.
        config: which voxels are obstacles. Standard deviations are without the error that the
            whole map shares, as a robot that is located in the map shares it too.
        band: the map is seen from above: a column is an obstacle if one of its voxels with their
            centers in the band is, and known if one is. Thresholds are those of `config`.

    Returns:
        Rows of x, y, z [m, map] of a voxel's center, of a column at half the height of the band,
        and the distance [m], shape (K, 4).

    Raises:
        InvalidInputError: the map is too large for an array.
    """
    options, size = config or DistanceConfig(), voxel_map.config.voxel_size
    bounds = voxel_map.bounds()
    if bounds is None:
        return np.zeros((0, 4), np.float32)
    reach = _NEIGHBORHOOD * size
    low, high = (bounds[0] + 0.25) * size - reach, (bounds[1] + 0.75) * size + reach
    if band is not None:
        low[2], high[2] = np.clip((band.low - reach, band.high + reach), low[2], high[2])
    if np.prod((high - low) / size) > _MOST_DISTANCES:
        raise InvalidInputError("map", f"is too large, it reaches {(high - low).tolist()} m")
    window = voxel_map.window(low, high)
    states = window.states()
    known = states != voxel_window.UNKNOWN
    lowest = voxel_window.OCCUPIED if options.unknown_is_free else voxel_window.UNCERTAIN
    blocked = states >= lowest
    if options.margin:
        _, means, covariances = voxel_map.gaussians(relative=True)
        sides = options.margin * _surface_reaches(covariances)
        _fill_boxes(window.positions_of(means - sides), window.positions_of(means + sides), blocked)
    if band is not None:
        heights = (np.arange(states.shape[2]) + window.first[2] + 0.5) * size
        inside = (heights >= band.low) & (heights <= band.high)
        known = np.asarray(known[..., inside].any(axis=2, keepdims=True))
        blocked = np.asarray(blocked[..., inside].any(axis=2, keepdims=True))
    if not options.unknown_is_free:
        blocked |= ~known
    field = field_of_blocked(blocked, window.first, size, outside_is_free=True)
    places = np.argwhere(known)
    rows = np.empty((len(places), 4), np.float32)
    rows[:, :3] = window.centers_of(places)
    if band is not None:
        rows[:, 2] = 0.5 * (band.low + band.high)
    rows[:, 3] = np.minimum(field.distances[known], options.limit)
    return rows


_NEIGHBORHOOD = 3  # voxels, within which the state of one depends on others
_MOST_DISTANCES = 1 << 27  # voxels, for which memory is some 2 GB


def _surface_reaches(covariances: NDArray[np.float64]) -> NDArray[np.float64]:
    """How far one standard deviation along the normal leads along x, y and z, shape (K, 3) [m].

    A Gaussian that is not flat has no normal: its own standard deviations.
    """
    variances, axes = np.linalg.eigh(covariances)
    reaches = np.abs(np.sqrt(variances[:, :1]) * axes[:, :, 0])
    round_ones = variances[:, 0] > ray_casting.FLAT * variances[:, 1:].mean(axis=1)
    reaches[round_ones] = np.sqrt(np.diagonal(covariances[round_ones], axis1=1, axis2=2))
    return np.asarray(reaches)


@njit(cache=True, nogil=True)
def _fill_boxes(low: Any, high: Any, blocked: Any) -> None:
    """Set the voxels of boxes, corners of shape (K, 3) inclusive, as far as they are there."""
    nx, ny, nz = blocked.shape
    for row in range(len(low)):
        for i in range(max(low[row, 0], 0), min(high[row, 0] + 1, nx)):
            for j in range(max(low[row, 1], 0), min(high[row, 1] + 1, ny)):
                for k in range(max(low[row, 2], 0), min(high[row, 2] + 1, nz)):
                    blocked[i, j, k] = True


def _log_odds(probability: float) -> float:
    with np.errstate(divide="ignore"):
        return float(np.log(probability) - np.log1p(-probability))


PLY_VERTEX = np.dtype(
    [
        *((name, "<f4") for name in ("x", "y", "z", "probability", "sigma")),
        *((name, "u1") for name in ("red", "green", "blue")),
    ]
)
"""One vertex of `write_ply`: position [m, map], occupancy probability, standard deviation along the
surface normal [m], color by height."""

_COLORS = np.array(  # dark blue, blue, green, yellow-green, yellow: of rising lightness
    [(68, 1, 84), (59, 82, 139), (33, 145, 140), (94, 201, 98), (253, 231, 37)], dtype=np.float64
)
_PLY_TYPES = {"<f4": "float", "|u1": "uchar"}
_STL_TRIANGLE = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("unused", "<u2")])
_GRAY = {FREE: 254, OCCUPIED: 0}  # pixels as ``map_saver`` writes them
_UNKNOWN_GRAY = 205


def write_ply(voxel_map: VoxelMap, path: str | Path) -> int:
    """Write the surface voxels as a binary PLY point cloud.

    Args:
        voxel_map: the map.
        path: file to write; one that is there is replaced.

    Returns:
        Number of vertices.

    Raises:
        OSError: the file cannot be written.
    """
    comment = "position in m, frame map; sigma in m along the surface normal; color by height"
    return write_vertices(surface_vertices(voxel_map), path, comment)


def write_vertices(vertices: NDArray[np.void], path: str | Path, comment: str) -> int:
    """Write records of `PLY_VERTEX`, shape (K,), as a binary PLY with a comment, as `write_ply`."""
    properties = [
        f"property {_PLY_TYPES[PLY_VERTEX[name].str]} {name}" for name in PLY_VERTEX.names or ()
    ]
    header = [
        "ply",
        "format binary_little_endian 1.0",
        f"comment {comment}",
        f"element vertex {len(vertices)}",
        *properties,
        "end_header",
    ]
    with replacing(path) as file:
        file.write("\n".join([*header, ""]).encode("ascii"))
        file.write(vertices.tobytes())
    return len(vertices)


def surface_vertices(voxel_map: VoxelMap) -> NDArray[np.void]:
    """Surface voxels as records of `PLY_VERTEX`, shape (K,)."""
    indices, means, covariances = voxel_map.gaussians()
    centers = (indices + 0.5) * voxel_map.config.voxel_size
    vertices = np.zeros(len(means), dtype=PLY_VERTEX)
    vertices["x"], vertices["y"], vertices["z"] = means.T
    vertices["probability"] = voxel_map.probability(centers)
    vertices["sigma"] = surface_sigmas(covariances)
    colors = height_colors(means[:, 2])
    vertices["red"], vertices["green"], vertices["blue"] = colors.T
    return vertices


def surface_sigmas(covariances: NDArray[np.float64]) -> NDArray[np.float64]:
    """Standard deviations along the surface normal, (K, 3, 3) [m^2] -> (K,) [m].

    The normal is where a surface voxel's Gaussian is thinnest.
    """
    sigmas = np.empty(len(covariances))
    _thinnest(np.ascontiguousarray(covariances, dtype=np.float64), sigmas)
    return sigmas


@njit(cache=True, nogil=True)
def _thinnest(covariances: Any, sigmas: Any) -> None:
    """Roots of the smallest eigenvalues, by the closed form for symmetric 3x3 matrices.

    O. K. Smith, "Eigenvalues of a symmetric 3 x 3 matrix", Communications of the ACM 4(4), 1961,
    https://doi.org/10.1145/355578.366316.
    """
    for row in range(len(covariances)):
        c = covariances[row]
        middle = (c[0, 0] + c[1, 1] + c[2, 2]) / 3.0
        x, y, z = c[0, 0] - middle, c[1, 1] - middle, c[2, 2] - middle
        a, b, d = c[1, 0], c[2, 0], c[2, 1]
        spread = math.sqrt((x * x + y * y + z * z + 2.0 * (a * a + b * b + d * d)) / 6.0)
        smallest = middle
        if spread > 0.0:
            determinant = x * (y * z - d * d) - a * (a * z - d * b) + b * (a * d - y * b)
            half = 0.5 * determinant / (spread * spread * spread)
            angle = math.acos(min(max(half, -1.0), 1.0)) / 3.0
            smallest += 2.0 * spread * math.cos(angle + 2.0 * math.pi / 3.0)
        sigmas[row] = math.sqrt(max(smallest, 0.0))


def height_colors(heights: NDArray[np.float64]) -> NDArray[np.uint8]:
    """Colors from dark blue (low) to yellow (high), shape (K,) [m] -> (K, 3) RGB.

    The scale runs from the 1st to the 99th percentile, so that an outlier does not fade the rest.
    """
    if not len(heights):
        return np.zeros((0, 3), dtype=np.uint8)
    low, high = np.percentile(heights, [1.0, 99.0])
    share = np.clip((heights - low) / max(high - low, 1e-9), 0.0, 1.0)
    stops = np.linspace(0.0, 1.0, len(_COLORS))
    channels = [np.interp(share, stops, _COLORS[:, i]) for i in range(3)]
    return np.rint(np.stack(channels, axis=1)).astype(np.uint8)


def write_stl(voxel_map: VoxelMap, path: str | Path) -> int:
    """Write the faces between occupied voxels (p > 0.5) and others as a binary STL mesh.

    The mesh is closed; its triangles turn counterclockwise as seen from outside. Coordinates in m,
    map frame.

    Args:
        voxel_map: the map.
        path: file to write; one that is there is replaced.

    Returns:
        Number of triangles.

    Raises:
        OSError: the file cannot be written.
    """
    indices, log_odds = voxel_map.voxels()
    occupied = indices[log_odds > 0.0].astype(np.int64)
    keys = pack_all(occupied)
    sides = []
    for axis in range(3):
        for end in (0, 1):
            beside = occupied.copy()
            beside[:, axis] += 2 * end - 1
            sides.append(_triangles(occupied[~np.isin(pack_all(beside), keys)], axis, end))
    triangles = np.concatenate(sides)
    triangles["corners"] *= voxel_map.config.voxel_size
    with replacing(path) as file:
        file.write(b"infomap_ros, meters".ljust(80) + np.uint32(len(triangles)).tobytes())
        file.write(triangles.tobytes())
    return len(triangles)


def _triangles(indices: NDArray[np.int64], axis: int, end: int) -> NDArray[np.void]:
    """Two triangles for the face of each voxel at the lower or upper end of an axis [voxels]."""
    second, third = (axis + 1) % 3, (axis + 2) % 3
    square = np.zeros((4, 3))
    square[:, axis] = end
    square[[1, 2], second] = square[[2, 3], third] = 1.0
    order = [0, 1, 2, 0, 2, 3] if end else [0, 2, 1, 0, 3, 2]
    triangles = np.zeros(2 * len(indices), dtype=_STL_TRIANGLE)
    triangles["normal"][:, axis] = 2 * end - 1
    triangles["corners"] = (indices[:, None] + square[order]).reshape(-1, 3, 3)
    return triangles


def write_grid(
    voxel_map: VoxelMap, path: str | Path, config: ProjectionConfig | None = None
) -> tuple[int, int]:
    """Write the map seen from above for ``nav2_map_server``: a .yaml file and a .pgm image.

    The thresholds in the .yaml file tell the three grays of the image apart, as free, occupied and
    unknown (mode ``trinary``).

    Args:
        voxel_map: the map.
        path: the .yaml file; the image is beside it. Those that are there are replaced.
        config: height band and thresholds, as of `project_map`.

    Returns:
        Cells along x and y.

    Raises:
        OSError: a file cannot be written.
    """
    grid, place = project_map(voxel_map, config), Path(path)
    pixels: NDArray[np.uint8] = np.full(grid.cells.shape, _UNKNOWN_GRAY, np.uint8)
    for state, gray in _GRAY.items():
        pixels[grid.cells == state] = gray
    rows, columns = pixels.shape
    image = place.with_suffix(".pgm")
    with replacing(image) as file:
        file.write(f"P5\n{columns} {rows}\n255\n".encode("ascii"))
        file.write(pixels[::-1].tobytes())  # an image begins with the largest y
    x, y = grid.origin
    lines = [
        f"image: {json.dumps(image.name)}",
        "mode: trinary",
        f"resolution: {float(grid.resolution)}",
        f"origin: [{float(x)}, {float(y)}, 0.0]",
        *("negate: 0", "occupied_thresh: 0.65", "free_thresh: 0.196"),
    ]
    write_text(place, "\n".join([*lines, ""]))
    return columns, rows


def write_distances(voxel_map: VoxelMap, path: str | Path) -> tuple[int, int, int]:
    """Write the distance to the nearest voxel that is not free as NumPy's .npz.

    The file holds ``distances``, float32, shape (nx, ny, nz) [m]: from the center of each voxel to
    the nearest blocked voxel, a cube; 0 in a blocked voxel. What is occupied, uncertain or was
    never observed is blocked, and so is all outside. ``origin``, shape (3,) [m, map frame], is the
    lower corner of the first voxel, ``voxel_size`` its edge [m]: the center of voxel (i, j, k) is
    ``origin + (i + 0.5, j + 0.5, k + 0.5) * voxel_size``.

    Args:
        voxel_map: the map.
        path: file to write; one that is there is replaced.

    Returns:
        Voxels along x, y and z.

    Raises:
        InvalidInputError: the map is empty, or too large for an array.
        OSError: the file cannot be written.
    """
    bounds, size = voxel_map.bounds(), voxel_map.config.voxel_size
    if bounds is None:
        raise InvalidInputError("map", "is empty")
    low, high = bounds[0] + 0.25, bounds[1] + 0.75  # within the outermost voxels
    field = distance_field(voxel_map.window(low * size, high * size))
    with replacing(path) as file:
        np.savez_compressed(
            file,
            distances=field.distances,
            origin=field.first * size,
            voxel_size=np.float64(size),
        )
    x, y, z = field.distances.shape
    return x, y, z
