"""One scan, gathered by voxel before it meets the map.

The points of one scan share the error of the sensor's pose. They are therefore averaged per voxel
first, and count as one observation of that voxel. Which voxels a point informs is the matter of
`infomap_ros.mapping.scans.association`.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from infomap_ros.mapping.voxels.keys import pack, table_slot, unpack

POINTS, OFFSET, COVARIANCE, NORMAL, INSIDE = 0, 1, 4, 10, 13
"""Columns of `ScanRows.sums`: number of points, sums of their offset from the voxel's centre [m],
of their covariance in the sensor frame (xx, xy, xz, yy, yz, zz) [m^2], of their unit normals in
the map frame, and the number of points that lie in the voxel itself."""

SUM_COLUMNS = 16

GROUP_SIZE = 13


class ScanRows(NamedTuple):
    """Scratch storage of a scan: one row per voxel.

    Attributes:
        table: hash table, row or -1, int32.
        keys: packed voxel index of each row, int64.
        sums: shape (n, 16), float32; columns above.
        used: number of rows, int64, shape (1,).
    """

    table: NDArray[np.int32]
    keys: NDArray[np.int64]
    sums: NDArray[np.float32]
    used: NDArray[np.int64]


def empty_rows(capacity: int = 1 << 15) -> ScanRows:
    """Scratch storage with room for `capacity` voxels."""
    return ScanRows(
        np.full(2 * capacity, -1, np.int32),
        np.empty(capacity, np.int64),
        np.empty((capacity, SUM_COLUMNS), np.float32),
        np.zeros(1, np.int64),
    )


def clear_rows(rows: ScanRows) -> None:
    """Forget the rows, keep the storage."""
    rows.table.fill(-1)
    rows.used[0] = 0


@njit(cache=True, nogil=True)
def row_of(rows: Any, key: int) -> Any:
    """Row of a voxel, made if need be; -1 when the storage is full."""
    return _row_of(rows.table, rows.keys, rows.sums, rows.used, key)


@njit(cache=True, nogil=True)
def _row_of(table: Any, keys: Any, sums: Any, used: Any, key: int) -> Any:
    """`row_of` on the arrays themselves: unpacking a tuple of arrays costs more than the search."""
    place = table_slot(key, len(table))
    while True:
        row = np.int64(table[place])
        if row < 0:
            break
        if keys[row] == key:
            return row
        place += 1
        if place == len(table):
            place = 0
    row = used[0]
    if row == len(keys):
        return np.int64(-1)
    used[0] = row + 1
    table[place] = row
    keys[row] = key
    for i in range(SUM_COLUMNS):
        sums[row, i] = 0.0
    return row


@njit(cache=True, nogil=True)
def axis_start(position: float, direction: float, cell: int) -> tuple[int, float, float]:
    """Step, parameter of the first crossing and its increment along one axis of a traversal."""
    if direction > 0.0:
        return 1, (cell + 1 - position) / direction, 1.0 / direction
    if direction < 0.0:
        return -1, (cell - position) / direction, -1.0 / direction
    return 0, np.inf, np.inf


@njit(cache=True, nogil=True)
def add_group(
    table: Any,
    keys: Any,
    sums: Any,
    used: Any,
    sensor: Any,
    reach: Any,
    axis: Any,
    groups: Any,
    slot: int,
) -> bool:
    """Give a group to every voxel it may belong to, and clear its slot.

    Args:
        table: of the `ScanRows`, likewise keys, sums and used.
        keys: see table.
        sums: see table.
        used: see table.
        sensor: a `Sensor`.
        reach: half the association segment, map frame [voxels].
        axis: unit normal, map frame.
        groups: points that lie in one voxel and share one normal and reach, one group per slot:
            number of points, voxel (3), sums of the points' offsets from the voxel's centre
            [voxels] (3) and of their covariances in the sensor frame [m^2] (6).
        slot: of the group.

    Returns:
        False when the storage of the rows is full.
    """
    count = groups[slot, 0]
    ox, oy, oz = groups[slot, 4] / count, groups[slot, 5] / count, groups[slot, 6] / count
    rx, ry, rz = reach[0], reach[1], reach[2]
    stored = True
    if abs(ox) + abs(rx) < 0.5 and abs(oy) + abs(ry) < 0.5 and abs(oz) + abs(rz) < 0.5:
        row = _row_of(table, keys, sums, used, _key_near(groups, slot, 0, 0, 0))
        stored = row >= 0
        if stored:
            _add_to_row(sums, row, sensor.size, 0, 0, 0, axis, groups, slot)
    else:
        x, y, z = ox + 0.5 - rx, oy + 0.5 - ry, oz + 0.5 - rz
        i, j, k = int(np.floor(x)), int(np.floor(y)), int(np.floor(z))
        step_x, next_x, delta_x = axis_start(x, 2.0 * rx, i)
        step_y, next_y, delta_y = axis_start(y, 2.0 * ry, j)
        step_z, next_z, delta_z = axis_start(z, 2.0 * rz, k)
        leave = 0.0
        while leave <= 1.0 and stored:
            row = _row_of(table, keys, sums, used, _key_near(groups, slot, i, j, k))
            stored = row >= 0
            if stored:
                _add_to_row(sums, row, sensor.size, i, j, k, axis, groups, slot)
            leave = min(next_x, min(next_y, next_z))
            if next_x == leave:
                i += step_x
                next_x += delta_x
            elif next_y == leave:
                j += step_y
                next_y += delta_y
            else:
                k += step_z
                next_z += delta_z
    for n in range(GROUP_SIZE):
        groups[slot, n] = 0.0
    return stored


@njit(cache=True, nogil=True)
def _key_near(groups: Any, slot: int, i: int, j: int, k: int) -> int:
    """Key of the voxel that lies (i, j, k) from a group's own."""
    return pack(int(groups[slot, 1]) + i, int(groups[slot, 2]) + j, int(groups[slot, 3]) + k)


@njit(cache=True, nogil=True)
def _add_to_row(
    sums: Any, row: int, size: float, i: int, j: int, k: int, axis: Any, groups: Any, slot: int
) -> None:
    """Add a group to the row of the voxel that lies (i, j, k) from its own."""
    count = groups[slot, 0]
    sums[row, 0] += count
    sums[row, 1] += (groups[slot, 4] - i * count) * size
    sums[row, 2] += (groups[slot, 5] - j * count) * size
    sums[row, 3] += (groups[slot, 6] - k * count) * size
    for n in range(6):
        sums[row, 4 + n] += groups[slot, 7 + n]
    sums[row, 10] += axis[0] * count
    sums[row, 11] += axis[1] * count
    sums[row, 12] += axis[2] * count
    if i == 0 and j == 0 and k == 0:
        sums[row, 13] += count


@njit(cache=True, nogil=True)
def absorb_rows(source: Any, target: Any) -> None:
    """Move what one part of a scan says of the voxels of another part to that part.

    The rows stay in `source`, with no points.
    """
    table, keys, sums = target.table, target.keys, target.sums
    source_keys, source_sums = source.keys, source.sums
    for row in range(source.used[0]):
        key = source_keys[row]
        place = table_slot(key, len(table))
        while table[place] >= 0 and keys[table[place]] != key:
            place += 1
            if place == len(table):
                place = 0
        if table[place] >= 0:
            for i in range(SUM_COLUMNS):
                sums[table[place], i] += source_sums[row, i]
            source_sums[row, 0] = 0.0


@njit(cache=True, nogil=True)
def row_centre(key: int, size: float, centre: Any) -> None:
    """Centre of a voxel [m] from its key."""
    x, y, z = unpack(key)
    centre[0], centre[1], centre[2] = (x + 0.5) * size, (y + 0.5) * size, (z + 0.5) * size
