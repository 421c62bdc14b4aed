"""Exact traversal of the voxel grid by rays (Amanatides and Woo 1987).

Used for clouds without a camera, whose free space is what their rays cross.

Surface normals of an unorganized cloud, from the scatter of points in coarse cells.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from infomap_ros.geometry.kernel import inlined_kernel
from infomap_ros.mapping.scans.association import NEAREST, set_reach, voxel_position, within_limit
from infomap_ros.mapping.scans.scan import (
    INSIDE,
    SUM_COLUMNS,
    add_group,
    row_center,
    row_of,
    walk_through,
)
from infomap_ros.mapping.voxels.keys import (
    BLOCK_BITS,
    begin_walk,
    exit_distance,
    local_index,
    next_voxel,
    pack,
    table_slot,
)

CELL_VOXELS = 4.0
"""Edge length of a cell in voxels."""

_FEWEST = 5
_FLATNESS = 0.1
"""Largest share of the second smallest variance that the smallest may have in a flat cell."""

_BREADTH = 0.01
"""Smallest share of the largest variance that the second may have: a line has no normal."""


@njit(cache=True, nogil=True)
def cell_row(cells: Any, cell_size: float, x: float, y: float, z: float) -> Any:
    """Row of the cell that holds a point of the sensor frame [m], -1 when the storage is full."""
    scale = 1.0 / cell_size
    return row_of(
        cells, pack(int(np.floor(x * scale)), int(np.floor(y * scale)), int(np.floor(z * scale)))
    )


@njit(cache=True, nogil=True)
def gather_cells(cells: Any, points: Any, cell_size: float, max_range: float) -> bool:
    """Sum up the points of each cell.

    Args:
        cells: a `ScanRows`; receives number, sums and sums of products of the points, relative to
            their cell's corner, in its first ten columns.
        points: shape (n, 3), sensor frame [m].
        cell_size: [m].
        max_range: points farther away do not count [m].

    Returns:
        False when the storage is full.
    """
    sums = cells.sums
    for i in range(len(points)):
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        if not x * x + y * y + z * z <= max_range * max_range:
            continue
        row = cell_row(cells, cell_size, x, y, z)
        if row < 0:
            return False
        x -= np.floor(x / cell_size) * cell_size
        y -= np.floor(y / cell_size) * cell_size
        z -= np.floor(z / cell_size) * cell_size
        sums[row, 0] += 1.0
        sums[row, 1] += x
        sums[row, 2] += y
        sums[row, 3] += z
        sums[row, 4] += x * x
        sums[row, 5] += x * y
        sums[row, 6] += x * z
        sums[row, 7] += y * y
        sums[row, 8] += y * z
        sums[row, 9] += z * z
    return True


@njit(cache=True, nogil=True)
def find_normals(cells: Any) -> None:
    """Write the unit normal of each flat cell into columns 10 to 12, zero elsewhere."""
    sums = cells.sums
    scatter, mean = np.empty((3, 3)), np.empty(3)
    place = ((4, 5, 6), (5, 7, 8), (6, 8, 9))
    for row in range(cells.used[0]):
        count = np.float64(sums[row, 0])
        sums[row, 10], sums[row, 11], sums[row, 12] = 0.0, 0.0, 0.0
        if count < _FEWEST:
            continue
        for i in range(3):
            mean[i] = sums[row, 1 + i] / count
        for i in range(3):
            for j in range(3):
                scatter[i, j] = sums[row, place[i][j]] / count - mean[i] * mean[j]
        values, vectors = np.linalg.eigh(scatter)
        if values[0] < _FLATNESS * values[1] and values[1] > _BREADTH * values[2]:
            for i in range(3):
                sums[row, 10 + i] = vectors[i, 0]


@njit(cache=True, nogil=True)
def normal_at(cells: Any, cell_size: float, x: float, y: float, z: float, out: Any) -> None:
    """Unit normal at a point, facing the sensor; the line of sight where its cell is not flat."""
    row = cell_row(cells, cell_size, x, y, z)
    norm = np.sqrt(x * x + y * y + z * z)
    nx, ny, nz = -x / norm, -y / norm, -z / norm
    if row >= 0:
        a, b, c = cells.sums[row, 10], cells.sums[row, 11], cells.sums[row, 12]
        facing = a * nx + b * ny + c * nz
        if a * a + b * b + c * c > 0.0:
            sign = 1.0 if facing > 0.0 else -1.0
            nx, ny, nz = sign * a, sign * b, sign * c
    out[0], out[1], out[2] = nx, ny, nz


_ONE = np.uint64(1)
_LONGEST_MARGIN = 20.0


@njit(cache=True, nogil=True)
def gather_cloud(
    rows: Any,
    far: Any,
    cells: Any,
    sensor: Any,
    pose_covariance: Any,
    points: Any,
    covariances: Any,
    columns: Any,
    tallies: Any,
) -> bool:
    """Gather an unorganized scan.

    Args:
        rows: a `ScanRows`.
        far: `ScanRows` that receives the voxels where rays that found nothing in range end.
        cells: `ScanRows` with the normals of the scan.
        sensor: a `Sensor`.
        pose_covariance: shape (6, 6), convention of `geometry.transforms`.
        points: shape (n, 3), float32, sensor frame [m], NaN = no measurement.
        covariances: shape (n, k), or (1, k) for one covariance for all [m^2].
        columns: columns of xx, xy, xz, yy, yz, zz in `covariances`.
        tallies: int64, shape (4,), as in `gather_organized`.

    Returns:
        False when the scratch storage is full.
    """
    table, cubes, places = rows.table, rows.cubes, rows.places
    keys, sums, used = rows.keys, rows.sums, rows.used
    reach, axis, direction = np.zeros(3), np.zeros(3), np.zeros(3)
    group = np.zeros(SUM_COLUMNS, np.float32)
    shared = len(covariances) == 1
    for i in range(len(points)):
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        squared = np.float64(x * x + y * y + z * z)
        if not (NEAREST * NEAREST < squared < np.inf):
            continue
        norm = np.sqrt(squared)
        if norm > sensor.max_range:
            tallies[1] += 1
            if not _add_far(far, sensor, points[i], sensor.max_range / norm):
                return False
            continue
        row = 0 if shared else i
        normal_at(cells, CELL_VOXELS * sensor.size, x, y, z, direction)
        set_reach(
            sensor, pose_covariance, x, y, z, covariances, row, columns, direction, reach, axis
        )
        place = voxel_position(sensor, x, y, z)
        if not within_limit(place[0], place[1], place[2]):
            tallies[2] += 1
        elif not _set_group(group, place, sensor.size, covariances, row, columns, axis):
            tallies[3] += 1
        else:
            tallies[0] += 1
            key, walk = _voxel_key(place), walk_through(reach)
            if not add_group(
                table, cubes, places, keys, sums, used, sensor.size, reach, walk, key, group
            ):
                return False
    return True


@inlined_kernel
def _set_group(
    group: Any, place: Any, size: float, covariances: Any, row: int, columns: Any, axis: Any
) -> bool:
    """Make one point a group as `add_group` takes it; False when a variance is not positive.

    Args:
        group: receives it.
        place: of the point [voxels].
        size: of a voxel [m].
        covariances: see `gather_cloud`, likewise columns.
        row: of the point in `covariances`.
        columns: see covariances.
        axis: unit normal, map frame, shape (3,).
    """
    group[0] = 1.0
    for n in range(3):
        group[1 + n] = (place[n] - np.floor(place[n]) - 0.5) * size
        group[10 + n] = axis[n]
    for n in range(6):
        group[4 + n] = covariances[row, columns[n]]
    xx, yy, zz = group[4], group[7], group[9]
    return bool(xx > 0.0 and yy > 0.0 and zz > 0.0 and xx + yy + zz < np.inf)


@inlined_kernel
def _voxel_key(place: Any) -> Any:
    """Key of the voxel that holds a position [voxels]."""
    return pack(int(np.floor(place[0])), int(np.floor(place[1])), int(np.floor(place[2])))


@njit(cache=True, nogil=True)
def _add_far(far: Any, sensor: Any, point: Any, scale: float) -> bool:
    """Note the voxel in which ``scale * point`` lies; False when the storage is full."""
    place = voxel_position(sensor, scale * point[0], scale * point[1], scale * point[2])
    if not within_limit(place[0], place[1], place[2]):
        return True
    return bool(row_of(far, _voxel_key(place)) >= 0)


class FreeMarks(NamedTuple):
    """Scratch storage of the voxels that rays cross.

    Attributes:
        table: hash table, row or -1, int32.
        keys: packed block coordinates of each row, int64.
        bits: one bit per crossed voxel, uint64, shape (n, 8).
        used: number of rows, int64, shape (1,).
    """

    table: NDArray[np.int32]
    keys: NDArray[np.int64]
    bits: NDArray[np.uint64]
    used: NDArray[np.int64]


def empty_marks(capacity: int = 1 << 13) -> FreeMarks:
    """Scratch storage with room for `capacity` blocks."""
    return FreeMarks(
        np.full(2 * capacity, -1, np.int32),
        np.empty(capacity, np.int64),
        np.zeros((capacity, 8), np.uint64),
        np.zeros(1, np.int64),
    )


@njit(cache=True, nogil=True)
def _mark_row(marks: Any, key: int) -> Any:
    place = table_slot(key, len(marks.table))
    while True:
        row = marks.table[place]
        if row < 0:
            break
        if marks.keys[row] == key:
            return np.int64(row)
        place += 1
        if place == len(marks.table):
            place = 0
    count = marks.used[0]
    if count == len(marks.keys):
        return np.int64(-1)
    marks.used[0] = count + 1
    marks.table[place] = count
    marks.keys[count] = key
    marks.bits[count, :] = 0
    return count


@njit(cache=True, nogil=True)
def mark_ray(marks: Any, start: Any, end: Any, length: float) -> bool:
    """Mark the voxels that a ray crosses before `length`, the one that holds `end` excepted.

    Args:
        marks: a `FreeMarks`.
        start: shape (3,) [voxels].
        end: shape (3,) [voxels].
        length: share of the segment from start to end, in [0, 1].

    Returns:
        False when the scratch storage is full.
    """
    dx, dy, dz = end[0] - start[0], end[1] - start[1], end[2] - start[2]
    last = pack(int(np.floor(end[0])), int(np.floor(end[1])), int(np.floor(end[2])))
    voxel, crossings, steps, deltas = begin_walk(start[0], start[1], start[2], dx, dy, dz)
    block_key, row = np.int64(-1), np.int64(-1)
    while True:
        i, j, k = voxel
        if pack(i, j, k) == last or exit_distance(crossings) > length:
            return True
        key = pack(i >> BLOCK_BITS, j >> BLOCK_BITS, k >> BLOCK_BITS)
        if key != block_key:
            block_key, row = key, _mark_row(marks, key)
            if row < 0:
                return False
        local = local_index(i, j, k)
        marks.bits[row, local >> 6] |= _ONE << np.uint64(local & 63)
        voxel, crossings = next_voxel(voxel, crossings, steps, deltas)


@njit(cache=True, nogil=True)
def mark_free(marks: Any, rows: Any, far: Any, sensor: Any, gap: float) -> bool:
    """Mark what the rays of an unorganized scan cross, one ray per end voxel.

    A ray ends as evidence before it comes within reach of its surface: ``k sigma`` of its range,
    and where it would be within `gap` of the surface's tangent plane, so that a ray that grazes a
    floor does not free the floor's voxels.

    Args:
        marks: a `FreeMarks`.
        rows: `ScanRows` of the points in range.
        far: `ScanRows` of the rays that found nothing in range.
        sensor: a `Sensor`.
        gap: see above [voxels].

    Returns:
        False when the scratch storage is full.
    """
    start, end, center = np.empty(3), np.empty(3), np.empty(3)
    for i in range(3):
        start[i] = sensor.position[i] * sensor.inverse_size
    for row in range(far.used[0]):
        row_center(far.keys[row], 1.0, center)
        if not mark_ray(marks, start, center, 1.0):
            return False
    for row in range(rows.used[0]):
        if rows.sums[row, INSIDE] == 0.0:
            continue
        count = np.float64(rows.sums[row, 0])
        row_center(rows.keys[row], 1.0, center)
        length, along = 0.0, 0.0
        for i in range(3):
            end[i] = center[i] + rows.sums[row, 1 + i] / count * sensor.inverse_size
            end[i] = min(max(end[i], center[i] - 0.4999), center[i] + 0.4999)
            length += (end[i] - start[i]) ** 2
        length = np.sqrt(length)
        for i in range(3):
            along += (end[i] - start[i]) * rows.sums[row, 10 + i] / count
        incidence = max(abs(along) / max(length, 1e-9), 1.0 / _LONGEST_MARGIN)
        spread = 0.0
        for i in (4, 7, 9):
            spread += rows.sums[row, i] / count
        margin = gap / incidence + sensor.sigmas * np.sqrt(spread) * sensor.inverse_size
        if length > margin and not mark_ray(marks, start, end, (length - margin) / length):
            return False
    return True
