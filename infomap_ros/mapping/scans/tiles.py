"""The points of one tile of an organised scan, sorted into groups that lie in one voxel each.

`infomap_ros.mapping.scans.plain_tiles` does most of them faster.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from infomap_ros.geometry.kernel import kernel
from infomap_ros.mapping.scans.association import NEAREST, voxel_position, within_limit
from infomap_ros.mapping.scans.scan import SUM_COLUMNS
from infomap_ros.mapping.voxels.keys import pack

TILE = 8
PIXELS = TILE * TILE


class TileGroups(NamedTuple):
    """Groups of the points of one tile, and memory to find them.

    Attributes:
        keys: of the voxel of each group, int64.
        sums: number of points, sums of their offsets from the voxel's centre [voxels] (3) and of
            their covariances in the sensor frame [m^2] (6).
        tile: the points of the tile, float32, shape (192,).
        pixels: depth, position in the map [voxels] (3), shape (4, 64).
        pixel_keys: of the pixels' voxels, int64.
        columns: sums, smallest and largest of the covariances of each column of pixels, float32,
            shape (3, 72).
        reach: half the association segment, map frame, shape (3,) [voxels].
        axis: unit normal, map frame, shape (3,).
        normal: unit normal, sensor frame, shape (3,).
        one: a group as `add_group` takes it, shape (16,), float32.
    """

    keys: NDArray[np.int64]
    sums: NDArray[np.float64]
    tile: NDArray[np.float32]
    pixels: NDArray[np.float64]
    pixel_keys: NDArray[np.int64]
    columns: NDArray[np.float32]
    reach: NDArray[np.float64]
    axis: NDArray[np.float64]
    normal: NDArray[np.float64]
    one: NDArray[np.float32]


def empty_groups() -> TileGroups:
    """Memory for the groups of a tile."""
    return TileGroups(
        np.empty(PIXELS, np.int64),
        np.empty((PIXELS, 10)),
        np.empty(3 * PIXELS, np.float32),
        np.empty((4, PIXELS)),
        np.empty(PIXELS, np.int64),
        np.empty((3, 9 * TILE), np.float32),
        np.empty(3),
        np.empty(3),
        np.empty(3),
        np.zeros(SUM_COLUMNS, np.float32),
    )


@kernel
def group_of(keys: Any, used: int, key: int) -> int:
    """Number of the group of a voxel, `used` when there is none."""
    group = 0
    while group < used and keys[group] != key:
        group += 1
    return group


@kernel
def _add_run(keys: Any, sums: Any, used: int, key: int, run: Any) -> int:
    """Add consecutive points of a voxel to its group; returns the number of groups then.

    Args:
        keys: of the groups, likewise sums.
        sums: see keys.
        used: number of groups.
        key: of the voxel.
        run: number of points, sums of their offsets (3) and covariances (6).
    """
    if run[0] == 0.0:
        return used
    group = group_of(keys, used, key)
    if group == used:
        used += 1
        keys[group] = key
        for n in range(10):
            sums[group, n] = 0.0
    for n in range(10):
        sums[group, n] += run[n]
    return used


@kernel
def gather_tile(
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
) -> int:
    """Sort the points of one tile into `groups`; returns how many there are.

    Args:
        sensor: a `Sensor`.
        points: see `infomap_ros.mapping.scans.organised.gather_organised`, likewise covariances,
            columns, lower, upper and tallies.
        covariances: see points.
        columns: see points.
        v0: first row of the tile.
        u0: first column of the tile.
        margin: what is taken off a measured depth before space counts as empty [m].
        groups: a `TileGroups`.
        lower: see points.
        upper: see points.
        tallies: see points.
    """
    height, width = points.shape[0], points.shape[1]
    c0, c1, c2, c3, c4, c5 = columns
    keys, sums, used = groups.keys, groups.sums, 0
    squared_range = sensor.max_range**2
    stride = 0 if len(covariances) == 1 else 1
    i = j = k = np.inf
    key = np.int64(0)
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
                    used = _add_run(
                        keys, sums, used, key, (count, ox, oy, oz, xx, xy, xz, yy, yz, zz)
                    )
                    count = ox = oy = oz = xx = xy = xz = yy = yz = zz = 0.0
                    i, j, k = np.floor(mx), np.floor(my), np.floor(mz)
                    key = pack(int(i), int(j), int(k))
                    dx, dy, dz = mx - i, my - j, mz - k
                count += 1.0
                ox, oy, oz = ox + (dx - 0.5), oy + (dy - 0.5), oz + (dz - 0.5)
                xx, yy, zz = xx + a, yy + d, zz + f
                xy += covariances[row, c1]
                xz += covariances[row, c2]
                yz += covariances[row, c4]
            lower[v >> 1, u >> 1] = min(lower[v >> 1, u >> 1], depth)
            upper[v >> 1, u >> 1] = max(upper[v >> 1, u >> 1], depth)
    return _add_run(keys, sums, used, key, (count, ox, oy, oz, xx, xy, xz, yy, yz, zz))
