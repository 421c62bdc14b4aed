"""The points of one tile of an organized scan, sorted into groups that lie in one voxel each.

`infomap_ros.mapping.scans.plain_tiles` does most of them faster.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from infomap_ros.geometry.kernel import inlined_kernel
from infomap_ros.mapping.scans.association import NEAREST, voxel_position, within_limit
from infomap_ros.mapping.scans.scan import SUM_COLUMNS
from infomap_ros.mapping.voxels.keys import pack

TILE = 8
PIXELS = TILE * TILE
_NOTHING = (0.0,) * 10


class TileGroups(NamedTuple):
    """Groups of the points of one tile, and memory to find them.

    Attributes:
        keys: of the voxel of each group, int64.
        sums: number of points, sums of their offsets from the voxel's center [voxels] (3) and of
            their covariances in the sensor frame [m^2] (6).
        tile: the points of the tile, float32, shape (192,).
        pixels: depth, position in the map [voxels] (3), shape (4, 64).
        pixel_keys: of the pixels' voxels, int64.
        work: whole numbers of each pixel, int64, shape (4, 64).
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
    work: NDArray[np.int64]
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
        np.empty((4, PIXELS), np.int64),
        np.empty((3, 9 * TILE), np.float32),
        np.empty(3),
        np.empty(3),
        np.empty(3),
        np.zeros(SUM_COLUMNS, np.float32),
    )


@inlined_kernel
def group_of(keys: Any, used: int, key: int) -> int:
    """Number of the group of a voxel, `used` when there is none."""
    group = 0
    while group < used and keys[group] != key:
        group += 1
    return group


@inlined_kernel
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


@inlined_kernel
def gather_tile(
    sensor: Any, image: Any, v0: int, u0: int, margin: float, groups: Any, tallies: Any
) -> int:
    """Sort the points of one tile into `groups`; returns how many there are.

    Args:
        sensor: a `Sensor`.
        image: an `infomap_ros.mapping.scans.organized.OrganizedScan`.
        v0: first row of the tile.
        u0: first column of the tile.
        margin: what is taken off a measured depth before space counts as empty [m].
        groups: a `TileGroups`.
        tallies: see `infomap_ros.mapping.scans.organized.gather_organized`.
    """
    points, covariances, columns = image.points, image.covariances, image.columns
    lower, upper = image.lower, image.upper
    height, width = points.shape[0], points.shape[1]
    keys, sums, used = groups.keys, groups.sums, 0
    squared_range = sensor.max_range**2
    stride = 0 if len(covariances) == 1 else 1
    corner, key, run = (np.inf, np.inf, np.inf), np.int64(0), _NOTHING
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
                covariance = _covariance(covariances, stride * (v * width + u), columns)
                if not _has_variances(covariance):
                    tallies[3] += 1
                    continue
                place = voxel_position(sensor, x, y, z)
                if not within_limit(place[0], place[1], place[2]):
                    tallies[2] += 1
                    continue
                if not _lies_in(place, corner):
                    used = _add_run(keys, sums, used, key, run)
                    corner = np.floor(place[0]), np.floor(place[1]), np.floor(place[2])
                    key, run = pack(int(corner[0]), int(corner[1]), int(corner[2])), _NOTHING
                run = _with_point(run, place, corner, covariance)
            lower[v >> 1, u >> 1] = min(lower[v >> 1, u >> 1], depth)
            upper[v >> 1, u >> 1] = max(upper[v >> 1, u >> 1], depth)
    return _add_run(keys, sums, used, key, run)


@inlined_kernel
def _covariance(covariances: Any, row: int, columns: Any) -> Any:
    """Upper triangle of a covariance as a tuple."""
    c0, c1, c2, c3, c4, c5 = columns
    c = covariances
    return c[row, c0], c[row, c1], c[row, c2], c[row, c3], c[row, c4], c[row, c5]


@inlined_kernel
def _has_variances(c: Any) -> bool:
    """Whether the variances of an upper triangle are positive and finite."""
    return c[0] > 0.0 and c[3] > 0.0 and c[5] > 0.0 and c[0] + c[3] + c[5] < np.inf


@inlined_kernel
def _lies_in(place: Any, corner: Any) -> bool:
    """Whether a point lies in the voxel with this lower corner [voxels]."""
    dx, dy, dz = place[0] - corner[0], place[1] - corner[1], place[2] - corner[2]
    return 0.0 <= dx < 1.0 and 0.0 <= dy < 1.0 and 0.0 <= dz < 1.0


@inlined_kernel
def _with_point(run: Any, place: Any, corner: Any, c: Any) -> Any:
    """A run as `_add_run` takes it, with one more point of its voxel."""
    count, ox, oy, oz, xx, xy, xz, yy, yz, zz = run
    ox, oy = ox + (place[0] - corner[0] - 0.5), oy + (place[1] - corner[1] - 0.5)
    oz = oz + (place[2] - corner[2] - 0.5)
    xx, xy, xz = xx + c[0], xy + c[1], xz + c[2]
    return count + 1.0, ox, oy, oz, xx, xy, xz, yy + c[3], yz + c[4], zz + c[5]
