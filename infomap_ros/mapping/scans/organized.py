"""Gathering an organized scan: normals from the image, and how far each pixel sees.

The image is walked in tiles of 8 x 8 pixels. A tile shares one surface normal and one association
reach, taken at its center; every pixel adds its own point and covariance. Along the way each 2 x 2
cell learns the depths up to which it is certainly empty: the ground level of the pyramid that
`infomap_ros.mapping.scans.free_space` asks.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from infomap_ros.geometry.kernel import inlined_kernel, kernel
from infomap_ros.mapping.scans.association import (
    NEAREST,
    rotated,
    set_reach,
    variance_along,
)
from infomap_ros.mapping.scans.plain_tiles import (
    FAR,
    PLAIN,
    TILE,
    gather_plain_tile,
    gather_tile,
    place_tile,
)
from infomap_ros.mapping.scans.scan import add_group, walk_through

_LARGEST_WINDOW = 24


class OrganizedScan(NamedTuple):
    """An organized scan, and what is learnt of the depths of its pixels, for the kernels.

    Attributes:
        points: shape (H, W, 3), float32, sensor frame [m], NaN = no measurement.
        covariances: shape (H * W, k), or (1, k) for one covariance for all [m^2].
        columns: columns of xx, xy, xz, yy, yz, zz in `covariances`.
        pose_covariance: shape (6, 6), convention of `geometry.transforms`.
        focal: focal length [px].
        lower: depth up to which all measured pixels of a 2 x 2 cell see through, shape
            (ceil(H/2), ceil(W/2)); begins as inf and stays so where nothing was measured.
        upper: the same for the farthest-seeing pixel; begins as -inf.
    """

    points: NDArray[np.float32]
    covariances: NDArray[np.float32]
    columns: tuple[int, ...]
    pose_covariance: NDArray[np.float64]
    focal: float
    lower: NDArray[np.float32]
    upper: NDArray[np.float32]


@inlined_kernel
def _usable(points: Any, v: int, u: int) -> bool:
    z = points[v, u, 2]
    return z > NEAREST and np.isfinite(z)


@inlined_kernel
def _bend(points: Any, v: int, u: int, dv: int, du: int) -> float:
    """Deviation of the depth at a pixel from the line through its two neighbors [m].

    Infinite where a neighbor is missing. Depth along a line on a plane is linear in 1 / z.
    """
    height, width = points.shape[0], points.shape[1]
    if v - dv < 0 or u - du < 0 or v + dv >= height or u + du >= width:
        return np.inf
    if not (_usable(points, v - dv, u - du) and _usable(points, v + dv, u + du)):
        return np.inf
    before, after = points[v - dv, u - du, 2], points[v + dv, u + du, 2]
    return abs(2.0 * before * after / (before + after) - points[v, u, 2])


@inlined_kernel
def tile_normal(
    points: Any, v: int, u: int, focal: float, size: float, sigma: float, out: Any
) -> None:
    """Unit normal of the surface at a pixel, sensor frame, facing the sensor.

    Differences are taken over about two voxels or eight standard deviations, whichever is larger.
    Where the surface is not smooth over that window the line of sight stands in.

    Args:
        points: organized, shape (H, W, 3) [m].
        v: row.
        u: column.
        focal: focal length [px].
        size: voxel size [m].
        sigma: standard deviation of the range [m].
        out: receives the normal, shape (3,).
    """
    x, y, z = points[v, u, 0], points[v, u, 1], points[v, u, 2]
    norm = np.sqrt(x * x + y * y + z * z)
    out[0], out[1], out[2] = -x / norm, -y / norm, -z / norm
    window = int(max(size, 4.0 * sigma) * focal / z)
    window = min(max(window, 2), _LARGEST_WINDOW)
    tolerance = 0.5 * size + 3.0 * sigma
    if _bend(points, v, u, 0, window) > tolerance or _bend(points, v, u, window, 0) > tolerance:
        return
    ax = np.float64(points[v, u + window, 0]) - points[v, u - window, 0]
    ay = np.float64(points[v, u + window, 1]) - points[v, u - window, 1]
    az = np.float64(points[v, u + window, 2]) - points[v, u - window, 2]
    bx = np.float64(points[v + window, u, 0]) - points[v - window, u, 0]
    by = np.float64(points[v + window, u, 1]) - points[v - window, u, 1]
    bz = np.float64(points[v + window, u, 2]) - points[v - window, u, 2]
    nx, ny, nz = by * az - bz * ay, bz * ax - bx * az, bx * ay - by * ax
    length = np.sqrt(nx * nx + ny * ny + nz * nz)
    if length > 0.0:
        if nx * x + ny * y + nz * z > 0.0:
            length = -length
        out[0], out[1], out[2] = nx / length, ny / length, nz / length


@inlined_kernel
def _tile_center(points: Any, v0: int, u0: int) -> tuple[int, int]:
    """A usable pixel of a tile, as near its middle as there is; (-1, -1) when there is none."""
    height, width = points.shape[0], points.shape[1]
    v, u = min(v0 + TILE // 2, height - 1), min(u0 + TILE // 2, width - 1)
    if _usable(points, v, u):
        return v, u
    best, best_v, best_u = 1e9, -1, -1
    for v in range(v0, min(v0 + TILE, height)):
        for u in range(u0, min(u0 + TILE, width)):
            if _usable(points, v, u):
                distance = (v - v0 - 3.6) ** 2 + (u - u0 - 3.7) ** 2
                if distance < best:
                    best, best_v, best_u = distance, v, u
    return best_v, best_u


@kernel
def gather_organized(
    rows: Any,
    sensor: Any,
    image: Any,
    first_row: int,
    last_row: int,
    tallies: Any,
    groups: Any,
) -> bool:
    """Gather the image rows [first_row, last_row) of an organized scan.

    Args:
        rows: a `ScanRows`.
        sensor: a `Sensor`.
        image: an `OrganizedScan`.
        first_row: multiple of 8.
        last_row: multiple of 8 or H.
        tallies: int64, shape (4,): points taken, out of range, beyond the coordinate limit, with
            a covariance that is not positive.
        groups: a `TileGroups` to work with.

    Returns:
        False when the scratch storage is full.
    """
    points, flat, table = image.points, image.points.reshape(-1), image.covariances.reshape(-1)
    for v0 in range(first_row, last_row, TILE):
        for u0 in range(0, points.shape[1], TILE):
            state = place_tile(sensor, image, flat, v0, u0, groups, tallies)
            if state == FAR:
                continue
            v, u = _tile_center(points, v0, u0)
            if v < 0:
                continue
            margin, count = _prepare_tile(sensor, image, v, u, groups), -1
            if state == PLAIN:
                count = gather_plain_tile(image, table, v0, u0, margin, groups)
            if count < 0:
                count = gather_tile(sensor, image, v0, u0, margin, groups, tallies)
            if not _add_groups(rows, sensor.size, groups, count, tallies):
                return False
    return True


@inlined_kernel
def _prepare_tile(sensor: Any, image: Any, v: int, u: int, groups: Any) -> float:
    """Find normal and reach of a tile at one of its pixels.

    Args:
        sensor: a `Sensor`.
        image: an `OrganizedScan`.
        v: row of the pixel.
        u: its column.
        groups: a `TileGroups`; receives normal, axis and reach.

    Returns:
        What is taken off a measured depth before space counts as empty [m].
    """
    points, covariances, columns = image.points, image.covariances, image.columns
    row = 0 if len(covariances) == 1 else v * points.shape[1] + u
    x, y, z = points[v, u, 0], points[v, u, 1], points[v, u, 2]
    norm = np.sqrt(x * x + y * y + z * z)
    dx, dy, dz = x / norm, y / norm, z / norm
    along = max(0.0, variance_along(covariances, row, columns, dx, dy, dz))
    tile_normal(points, v, u, image.focal, sensor.size, np.sqrt(along), groups.normal)
    place = groups.normal, groups.reach, groups.axis
    set_reach(sensor, image.pose_covariance, x, y, z, covariances, row, columns, *place)
    return _depth_margin(sensor, image.pose_covariance, along, dx, dy, dz)


@inlined_kernel
def _add_groups(rows: Any, size: float, groups: Any, count: int, tallies: Any) -> bool:
    """Give the groups of a tile to the rows; False when their storage is full.

    Args:
        rows: a `ScanRows`.
        size: of a voxel [m].
        groups: a `TileGroups`.
        count: number of groups.
        tallies: receives the number of points taken.
    """
    table, cubes, places = rows.table, rows.cubes, rows.places
    keys, sums, used = rows.keys, rows.sums, rows.used
    group_keys, group_sums, group = groups.keys, groups.sums, groups.one
    reach, axis = groups.reach, groups.axis
    walk = walk_through(reach)
    for i in range(count):
        points = group_sums[i, 0]
        group[0] = points
        for n in range(3):
            group[1 + n] = group_sums[i, 1 + n] * size
            group[10 + n] = axis[n] * points
        for n in range(4, 10):
            group[n] = group_sums[i, n]
        tallies[0] += int(points)
        if not add_group(
            table, cubes, places, keys, sums, used, size, reach, walk, group_keys[i], group
        ):
            return False
    return True


@inlined_kernel
def _depth_margin(sensor: Any, c: Any, variance: float, dx: float, dy: float, dz: float) -> float:
    """What is taken off a measured depth before space counts as empty [m]."""
    mx, my, mz = rotated(sensor.rotation, dx, dy, dz)
    pose = mx * mx * c[0, 0] + my * my * c[1, 1] + mz * mz * c[2, 2]
    pose += 2.0 * (mx * my * c[0, 1] + mx * mz * c[0, 2] + my * mz * c[1, 2])
    return sensor.sigmas * np.sqrt(variance + max(pose, 0.0)) * dz
