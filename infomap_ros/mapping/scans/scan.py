"""One scan, gathered by voxel before it meets the map.

The points of one scan share the error of the sensor's pose. They are therefore averaged per voxel
first, and count as one observation of that voxel. Which voxels a point informs is the matter of
`infomap_ros.mapping.scans.association`.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from infomap_ros.geometry.kernel import inlined_kernel, kernel
from infomap_ros.mapping.voxels.keys import (
    KEY_X,
    KEY_Y,
    exit_distance,
    next_of_short_walk,
    table_slot,
    unpack,
)

POINTS, OFFSET, COVARIANCE, NORMAL, INSIDE = 0, 1, 4, 10, 13
"""Columns of `ScanRows.sums`: number of points, sums of their offset from the voxel's center [m],
of their covariance in the sensor frame (xx, xy, xz, yy, yz, zz) [m^2], of their unit normals in
the map frame, and the number of points that lie in the voxel itself."""

SUM_COLUMNS = 16

_CACHE_LINE = 64  # [bytes]
_CUBE_VOXELS = 64
_WITHIN = 3 | (3 << KEY_Y) | (3 << KEY_X)


class ScanRows(NamedTuple):
    """Scratch storage of a scan: one row per voxel, found through cubes of 4 x 4 x 4 voxels.

    Attributes:
        table: hash table of the cubes, number or -1, int32.
        cubes: key of a voxel of each cube with the lowest bits of its coordinates cleared, int64.
        places: row of each voxel of a cube or -1, int32, shape (m, 64).
        keys: packed voxel index of each row, int64.
        sums: shape (n, 16), float32; columns above.
        used: number of rows and of cubes, and the cube that was asked last, int64, shape (3,).
    """

    table: NDArray[np.int32]
    cubes: NDArray[np.int64]
    places: NDArray[np.int32]
    keys: NDArray[np.int64]
    sums: NDArray[np.float32]
    used: NDArray[np.int64]


def empty_rows(capacity: int = 1 << 15) -> ScanRows:
    """Scratch storage with room for `capacity` voxels."""
    return ScanRows(
        np.full(capacity, -1, np.int32),
        np.full(capacity // 2, -1, np.int64),
        np.empty((capacity // 2, _CUBE_VOXELS), np.int32),
        np.empty(capacity, np.int64),
        _aligned_sums(capacity),
        np.zeros(3, np.int64),
    )


def _aligned_sums(capacity: int) -> NDArray[np.float32]:
    """Rows of sums, each of which is one line of the processor's cache."""
    memory = np.empty((capacity + 1) * SUM_COLUMNS, np.float32)
    skipped = (-memory.ctypes.data % _CACHE_LINE) // memory.itemsize
    return memory[skipped : skipped + capacity * SUM_COLUMNS].reshape(capacity, SUM_COLUMNS)


def clear_rows(rows: ScanRows) -> None:
    """Forget the rows, keep the storage."""
    rows.table.fill(-1)
    rows.cubes[0] = -1
    rows.used[:] = 0


@inlined_kernel
def row_of(rows: Any, key: int) -> Any:
    """Row of a voxel, made if need be; -1 when the storage is full."""
    return _row_of(rows.table, rows.cubes, rows.places, rows.keys, rows.sums, rows.used, key)


@inlined_kernel
def find_row(rows: Any, key: int) -> Any:
    """Row of a voxel or -1."""
    cube = _find_cube(rows.table, rows.cubes, key & ~_WITHIN)
    return np.int64(-1) if cube < 0 else np.int64(rows.places[cube, _place_in_cube(key)])


@inlined_kernel
def _place_in_cube(key: int) -> Any:
    return ((key >> KEY_X) & 3) | ((key >> (KEY_Y - 2)) & 12) | ((key & 3) << 4)


@inlined_kernel
def _find_cube(table: Any, cubes: Any, key: int) -> Any:
    """Number of a cube or -1."""
    place = table_slot(key, len(table))
    while table[place] >= 0 and cubes[table[place]] != key:
        place += 1
        if place == len(table):
            place = 0
    return np.int64(table[place])


@inlined_kernel
def _cube_of(table: Any, cubes: Any, places: Any, used: Any, key: int) -> Any:
    """Number of a cube, made if need be; -1 when the storage is full."""
    cube = used[2]
    if cubes[cube] != key:
        place = table_slot(key, len(table))
        while table[place] >= 0 and cubes[table[place]] != key:
            place += 1
            if place == len(table):
                place = 0
        cube = np.int64(table[place])
        if cube < 0 and used[1] < len(cubes):
            cube = used[1]
            used[1] = cube + 1
            table[place] = cube
            cubes[cube] = key
            for i in range(_CUBE_VOXELS):
                places[cube, i] = -1
        if cube >= 0:
            used[2] = cube
    return cube


@inlined_kernel
def _row_of(table: Any, cubes: Any, places: Any, keys: Any, sums: Any, used: Any, key: int) -> Any:
    """`row_of` on the arrays themselves, inlined: handing arrays over costs more than to search."""
    cube, row = _cube_of(table, cubes, places, used, key & ~_WITHIN), np.int64(-1)
    if cube >= 0:
        place = _place_in_cube(key)
        row = np.int64(places[cube, place])
        if row < 0 and used[0] < len(keys):
            row = used[0]
            used[0] = row + 1
            places[cube, place] = row
            keys[row] = key
            for i in range(SUM_COLUMNS):
                sums[row, i] = 0.0
    return row


@inlined_kernel
def add_group(
    table: Any,
    cubes: Any,
    places: Any,
    keys: Any,
    sums: Any,
    used: Any,
    size: float,
    reach: Any,
    walk: Any,
    key: int,
    group: Any,
) -> bool:
    """Give a group of points to every voxel it may belong to.

    Args:
        table: of the `ScanRows`, likewise cubes, places, keys, sums and used.
        cubes: see table.
        places: see table.
        keys: see table.
        sums: see table.
        used: see table.
        size: of a voxel [m].
        reach: half the association segment, map frame [voxels].
        walk: `walk_through` of it.
        key: of the voxel in which the points lie.
        group: of points that share one normal and reach, in the columns of `ScanRows.sums`,
            float32; how many lie in the voxel itself is not asked.

    Returns:
        False when the storage of the rows is full.
    """
    back = np.float64(group[0]) * size
    share = 1.0 / back
    steps, deltas = walk
    i, next_x = _begin(group[1] * share + 0.5 - reach[0], steps[0], deltas[0])
    j, next_y = _begin(group[2] * share + 0.5 - reach[1], steps[1], deltas[1])
    k, next_z = _begin(group[3] * share + 0.5 - reach[2], steps[2], deltas[2])
    voxel, crossings, leave = (i, j, k), (next_x, next_y, next_z), 0.0
    while leave <= 1.0:
        i, j, k = voxel
        near = key + (np.int64(i) << KEY_X) + (np.int64(j) << KEY_Y) + k
        row = _row_of(table, cubes, places, keys, sums, used, near)
        if row < 0:
            return False
        _add_to_row(sums, np.uint64(row), i * back, j * back, k * back, near == key, group)
        leave = exit_distance(crossings)
        voxel, crossings = next_of_short_walk(voxel, crossings, steps, deltas)
    return True


@inlined_kernel
def walk_through(reach: Any) -> Any:
    """Steps and distances between two crossings of a walk from ``-reach`` to ``reach``, by axis.

    The unit of distance is the whole walk.
    """
    (step_x, delta_x), (step_y, delta_y) = _axis(2.0 * reach[0]), _axis(2.0 * reach[1])
    step_z, delta_z = _axis(2.0 * reach[2])
    return (step_x, step_y, step_z), (delta_x, delta_y, delta_z)


@inlined_kernel
def _axis(direction: float) -> Any:
    step = np.int64(direction > 0.0) - np.int64(direction < 0.0)
    return step, abs(1.0 / direction)


@inlined_kernel
def _begin(position: float, step: int, delta: float) -> Any:
    """Voxel of a position along one axis, and the distance to where the walk leaves it."""
    cell = np.floor(position)
    ahead = cell + 1.0 - position if step > 0 else position - cell
    return np.int64(cell), ahead * delta if step != 0 else np.inf


@inlined_kernel
def _add_to_row(
    sums: Any, row: int, x: float, y: float, z: float, is_inside: bool, group: Any
) -> None:
    """Add a group to a row; its offsets are too large by (x, y, z) there."""
    s = sums[row]
    for n in range(len(group)):  # of a length not known here: else it is not done at once
        s[n] += group[n]
    s[1] -= x
    s[2] -= y
    s[3] -= z
    s[INSIDE] += group[0] if is_inside else np.float32(0.0)


@kernel
def absorb_rows(source: Any, target: Any) -> None:
    """Move what one part of a scan says of the voxels of another part to that part.

    The rows stay in `source`, with no points.
    """
    sums, source_sums = target.sums, source.sums
    for row in range(source.used[0]):
        found = find_row(target, source.keys[row])
        if found >= 0:
            for i in range(SUM_COLUMNS):
                sums[found, i] += source_sums[row, i]
            source_sums[row, 0] = 0.0


@inlined_kernel
def row_center(key: int, size: float, center: Any) -> None:
    """Center of a voxel [m] from its key."""
    x, y, z = unpack(key)
    center[0], center[1], center[2] = (x + 0.5) * size, (y + 0.5) * size, (z + 0.5) * size
