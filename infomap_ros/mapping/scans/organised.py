"""Gathering an organised scan: normals from the image, and how far each pixel sees.

The image is walked in tiles of 8 x 8 pixels. A tile shares one surface normal and one association
reach, taken at its centre; every pixel adds its own point and covariance. Along the way each 2 x 2
cell learns the depths up to which it is certainly empty: the ground level of the pyramid that
`infomap_ros.mapping.scans.free_space` asks.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit

from infomap_ros.mapping.scans.association import (
    NEAREST,
    rotated,
    set_reach,
    variance_along,
    voxel_position,
    within_limit,
)
from infomap_ros.mapping.scans.scan import GROUP_SIZE, add_group

TILE = 8
_LARGEST_WINDOW = 24


@njit(cache=True, nogil=True)
def _usable(points: Any, v: int, u: int) -> bool:
    z = points[v, u, 2]
    return z > NEAREST and np.isfinite(z)


@njit(cache=True, nogil=True)
def _bend(points: Any, v: int, u: int, dv: int, du: int) -> float:
    """Deviation of the depth at a pixel from the line through its two neighbours [m].

    Infinite where a neighbour is missing. Depth along a line on a plane is linear in 1 / z.
    """
    height, width = points.shape[0], points.shape[1]
    if v - dv < 0 or u - du < 0 or v + dv >= height or u + du >= width:
        return np.inf
    if not (_usable(points, v - dv, u - du) and _usable(points, v + dv, u + du)):
        return np.inf
    before, after = points[v - dv, u - du, 2], points[v + dv, u + du, 2]
    return abs(2.0 * before * after / (before + after) - points[v, u, 2])


@njit(cache=True, nogil=True)
def tile_normal(
    points: Any, v: int, u: int, focal: float, size: float, sigma: float, out: Any
) -> None:
    """Unit normal of the surface at a pixel, sensor frame, facing the sensor.

    Differences are taken over about two voxels or eight standard deviations, whichever is larger.
    Where the surface is not smooth over that window the line of sight stands in.

    Args:
        points: organised, shape (H, W, 3) [m].
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


@njit(cache=True, nogil=True)
def _tile_centre(points: Any, v0: int, u0: int) -> tuple[int, int]:
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


@njit(cache=True, nogil=True)
def gather_organised(
    rows: Any,
    sensor: Any,
    pose_covariance: Any,
    points: Any,
    covariances: Any,
    columns: Any,
    focal: float,
    first_row: int,
    last_row: int,
    lower: Any,
    upper: Any,
    tallies: Any,
) -> bool:
    """Gather the image rows [first_row, last_row) of an organised scan.

    Args:
        rows: a `ScanRows`.
        sensor: a `Sensor`.
        pose_covariance: shape (6, 6), convention of `geometry.transforms`.
        points: shape (H, W, 3), float32, sensor frame [m], NaN = no measurement.
        covariances: shape (H * W, k), or (1, k) for one covariance for all [m^2].
        columns: columns of xx, xy, xz, yy, yz, zz in `covariances`.
        focal: focal length [px].
        first_row: multiple of 8.
        last_row: multiple of 8 or H.
        lower: depth up to which all measured pixels of a 2 x 2 cell see through, shape
            (ceil(H/2), ceil(W/2)); inf where the cell has no measurement.
        upper: the same for the farthest-seeing pixel; -inf where there is none.
        tallies: int64, shape (4,): points taken, out of range, beyond the coordinate limit, with
            a covariance that is not positive.

    Returns:
        False when the scratch storage is full.
    """
    width = points.shape[1]
    table, keys, sums, used = rows.table, rows.keys, rows.sums, rows.used
    reach, axis, normal = np.zeros(3), np.zeros(3), np.zeros(3)
    groups = np.zeros((TILE * TILE + 1, GROUP_SIZE))
    shared = len(covariances) == 1
    lower[first_row >> 1 : (last_row + 1) >> 1] = np.inf
    upper[first_row >> 1 : (last_row + 1) >> 1] = -np.inf
    for v0 in range(first_row, last_row, TILE):
        for u0 in range(0, width, TILE):
            v, u = _tile_centre(points, v0, u0)
            margin = 0.0
            if v >= 0:
                row = 0 if shared else v * width + u
                x, y, z = points[v, u, 0], points[v, u, 1], points[v, u, 2]
                norm = np.sqrt(x * x + y * y + z * z)
                dx, dy, dz = x / norm, y / norm, z / norm
                along = max(0.0, variance_along(covariances, row, columns, dx, dy, dz))
                tile_normal(points, v, u, focal, sensor.size, np.sqrt(along), normal)
                set_reach(
                    sensor,
                    pose_covariance,
                    x,
                    y,
                    z,
                    covariances,
                    row,
                    columns,
                    normal,
                    reach,
                    axis,
                )
                margin = _depth_margin(sensor, pose_covariance, along, dx, dy, dz)
            _gather_tile(
                sensor, points, covariances, columns, v0, u0, margin, groups, lower, upper, tallies
            )
            slot = 0
            while groups[slot, 0] > 0.0:
                if not add_group(table, keys, sums, used, sensor, reach, axis, groups, slot):
                    return False
                slot += 1
    return True


@njit(cache=True, nogil=True)
def _depth_margin(sensor: Any, c: Any, variance: float, dx: float, dy: float, dz: float) -> float:
    """What is taken off a measured depth before space counts as empty [m]."""
    mx, my, mz = rotated(sensor.rotation, dx, dy, dz)
    pose = mx * mx * c[0, 0] + my * my * c[1, 1] + mz * mz * c[2, 2]
    pose += 2.0 * (mx * my * c[0, 1] + mx * mz * c[0, 2] + my * mz * c[1, 2])
    return sensor.sigmas * np.sqrt(variance + max(pose, 0.0)) * dz


@njit(cache=True, nogil=True)
def _slot_of(groups: Any, i: float, j: float, k: float) -> Any:
    """Slot of the group of voxel (i, j, k), made if need be."""
    slot = 0
    while groups[slot, 0] > 0.0:
        if groups[slot, 1] == i and groups[slot, 2] == j and groups[slot, 3] == k:
            return slot
        slot += 1
    groups[slot, 1], groups[slot, 2], groups[slot, 3] = i, j, k
    return slot


@njit(cache=True, nogil=True)
def _add_run(groups: Any, i: float, j: float, k: float, run: Any) -> None:
    """Add consecutive points of voxel (i, j, k) to its group.

    Args:
        groups: of the tile, a free slot has no points.
        i: voxel, likewise j and k.
        j: see i.
        k: see i.
        run: number of points, sums of their offsets (3) and covariances (6).
    """
    if run[0] == 0.0:
        return
    slot = _slot_of(groups, i, j, k)
    groups[slot, 0] += run[0]
    for n in range(1, 10):
        groups[slot, 3 + n] += run[n]


@njit(cache=True, nogil=True)
def _gather_tile(
    sensor: Any,
    points: Any,
    covariances: Any,
    columns: Any,
    v0: int,
    u0: int,
    margin: float,
    groups: Any,
    lower: Any,
    upper: Any,
    tallies: Any,
) -> None:
    """Sort the points of one tile into `groups`; see `gather_organised`."""
    height, width = points.shape[0], points.shape[1]
    c0, c1, c2, c3, c4, c5 = columns
    squared_range = sensor.max_range**2
    stride = 0 if len(covariances) == 1 else 1
    i = j = k = np.inf
    count = ox = oy = oz = xx = xy = xz = yy = yz = zz = 0.0
    for v in range(v0, min(v0 + TILE, height)):
        for u in range(u0, min(u0 + TILE, width)):
            x, y, z = points[v, u, 0], points[v, u, 1], points[v, u, 2]
            squared = x * x + y * y + z * z
            if not (z > NEAREST and squared < np.inf):
                continue
            depth = z - margin
            if squared > squared_range:
                depth = z * sensor.max_range / np.sqrt(squared)
                tallies[1] += 1
            else:
                row = stride * (v * width + u)
                a, d, f = covariances[row, c0], covariances[row, c3], covariances[row, c5]
                if not (a > 0.0 and d > 0.0 and f > 0.0 and a + d + f < np.inf):
                    tallies[3] += 1
                    continue
                mx, my, mz = voxel_position(sensor, x, y, z)
                if not within_limit(mx, my, mz):
                    tallies[2] += 1
                    continue
                dx, dy, dz = mx - i, my - j, mz - k
                if not (0.0 <= dx < 1.0 and 0.0 <= dy < 1.0 and 0.0 <= dz < 1.0):
                    _add_run(groups, i, j, k, (count, ox, oy, oz, xx, xy, xz, yy, yz, zz))
                    tallies[0] += int(count)
                    count = ox = oy = oz = xx = xy = xz = yy = yz = zz = 0.0
                    i, j, k = np.floor(mx), np.floor(my), np.floor(mz)
                    dx, dy, dz = mx - i, my - j, mz - k
                count += 1.0
                ox, oy, oz = ox + (dx - 0.5), oy + (dy - 0.5), oz + (dz - 0.5)
                xx, yy, zz = xx + a, yy + d, zz + f
                xy += covariances[row, c1]
                xz += covariances[row, c2]
                yz += covariances[row, c4]
            lower[v >> 1, u >> 1] = min(lower[v >> 1, u >> 1], depth)
            upper[v >> 1, u >> 1] = max(upper[v >> 1, u >> 1], depth)
    _add_run(groups, i, j, k, (count, ox, oy, oz, xx, xy, xz, yy, yz, zz))
    tallies[0] += int(count)
