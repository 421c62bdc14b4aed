"""Packed voxel and block coordinates, and their hashing.

Three 21-bit coordinates share one int64. A block is a cube of 8 x 8 x 8 voxels; the local index
of a voxel in its block is ``x + 8 y + 64 z``.

Sparse occupancy: blocks of 8 x 8 x 8 voxels in a hash table.

The evidence of a voxel is an exact integer, ``base of the block + delta of the voxel`` in log-odds
quanta, so sums do not depend on their order. A block stores only what it needs:

- UNIFORM: every voxel is known and has the value ``base``; no per-voxel storage. A block that a
  scan sees through entirely costs one addition.
- NARROW: one int8 delta per voxel.
- WIDE: one int16 delta per voxel, for blocks whose values differ by more than 254 quanta.

The smallest number of each type means "never observed". A value saturates at +-32767 quanta from
the base, 8000 nats, far beyond what a probability can express.

From voxel to voxel along a line (Amanatides and Woo 1987).
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from infomap_ros.geometry.kernel import inlined_kernel, kernel

KEY_X, KEY_Y = 42, 21
"""Bits by which x and y are shifted in a key."""

BLOCK_BITS = 3
BLOCK_SIDE = 1 << BLOCK_BITS
BLOCK_VOXELS = BLOCK_SIDE**3
COORDINATE_LIMIT = 1 << 20
"""Voxel indices lie in [-COORDINATE_LIMIT, COORDINATE_LIMIT)."""

_MASK = (1 << 21) - 1
_MULTIPLIER = np.uint64(0x9E3779B97F4A7C15)


@kernel
def pack(x: int, y: int, z: int) -> Any:
    """Pack three coordinates within the limit into one key."""
    limit = COORDINATE_LIMIT
    high = ((np.int64(x) + limit) << KEY_X) | ((np.int64(y) + limit) << KEY_Y)
    return high | (np.int64(z) + limit)


def pack_all(coordinates: NDArray[np.int64]) -> NDArray[np.int64]:
    """`pack` of many: shape (N, 3) -> (N,)."""
    x, y, z = (coordinates + COORDINATE_LIMIT).T
    return np.asarray((x << 42) | (y << 21) | z)


def unpack_all(keys: NDArray[np.int64]) -> NDArray[np.int64]:
    """Inverse of `pack_all`: shape (N,) -> (N, 3)."""
    return np.column_stack([keys >> 42, (keys >> 21) & _MASK, keys & _MASK]) - COORDINATE_LIMIT


@kernel
def unpack(key: int) -> tuple[int, int, int]:
    """Inverse of `pack`."""
    limit = COORDINATE_LIMIT
    return (key >> 42) - limit, ((key >> 21) & _MASK) - limit, (key & _MASK) - limit


@kernel
def table_slot(key: int, size: int) -> Any:
    """First slot of `key` in an open-addressing table of any `size` (multiply-shift)."""
    mixed = (np.uint64(key) * _MULTIPLIER) >> np.uint64(32)
    return np.int64((mixed * np.uint64(size)) >> np.uint64(32))


@kernel
def rehash(table: Any, keys: Any, count: int) -> None:
    """Enter the first `count` keys into an empty table."""
    for slot in range(count):
        place = table_slot(keys[slot], len(table))
        while table[place] >= 0:
            place += 1
            if place == len(table):
                place = 0
        table[place] = slot


@kernel
def local_index(x: int, y: int, z: int) -> int:
    """Index of a voxel within its block, from its voxel coordinates."""
    return (x & 7) | ((y & 7) << 3) | ((z & 7) << 6)


UNSEEN, UNIFORM, NARROW, WIDE = 0, 1, 2, 3
NARROW_UNKNOWN, WIDE_UNKNOWN = -128, -32768

BLOCK_COUNT, NARROW_COUNT, WIDE_COUNT, NARROW_FREE = range(4)
"""Places in `BlockArrays.counts`."""

BLOCK_BYTES, DIRTY_BYTES, PLANE_BYTES = 17, 64, BLOCK_VOXELS + 4
"""Memory of a block without voxels, of its record of changes, and of a NARROW plane [bytes]."""


class BlockArrays(NamedTuple):
    """The arrays of a `BlockStore`, as the kernels take them.

    Attributes:
        table: hash table, block slot or -1.
        keys: packed block coordinates of each slot, int64.
        base: int32 [quanta].
        kind: UNSEEN, UNIFORM, NARROW or WIDE, uint8.
        plane: row in `narrow` or `wide`, int32.
        narrow: int8 deltas, shape (n, 512).
        wide: int16 deltas, shape (n, 512).
        free_rows: rows of `narrow` to be used again, int32.
        dirty: bit set of the voxels that changed, uint64, shape (blocks, 8), or (0, 8) when
            changes are not tracked.
        counts: used rows, int64.
    """

    table: NDArray[np.int32]
    keys: NDArray[np.int64]
    base: NDArray[np.int32]
    kind: NDArray[np.uint8]
    plane: NDArray[np.int32]
    narrow: NDArray[np.int8]
    wide: NDArray[np.int16]
    free_rows: NDArray[np.int32]
    dirty: NDArray[np.uint64]
    counts: NDArray[np.int64]


def empty_blocks() -> BlockArrays:
    """Arrays of a store without blocks."""
    return BlockArrays(
        table=np.full(1024, -1, np.int32),
        keys=np.empty(512, np.int64),
        base=np.zeros(512, np.int32),
        kind=np.zeros(512, np.uint8),
        plane=np.zeros(512, np.int32),
        narrow=np.empty((256, BLOCK_VOXELS), np.int8),
        wide=np.empty((16, BLOCK_VOXELS), np.int16),
        free_rows=np.empty(256, np.int32),
        dirty=np.zeros((0, 8), np.uint64),
        counts=np.zeros(4, np.int64),
    )


def grown(
    array: NDArray[Any], needed: int, fill: int | None = None, used: int | None = None
) -> NDArray[Any]:
    """`array` with room for at least `needed` rows.

    Grows by half at least. Pages that were never written cost no memory, so that only used rows
    count; where `used` says how many those are, only they are copied.
    """
    if len(array) >= needed:
        return array
    capacity = max(needed, len(array) + len(array) // 2)
    shape = (capacity, *array.shape[1:])
    larger = np.empty(shape, array.dtype) if fill is None else np.full(shape, fill, array.dtype)
    kept = len(array) if used is None else used
    larger[:kept] = array[:kept]
    return larger


def with_room(arrays: BlockArrays, blocks: int, planes: int) -> BlockArrays:
    """Arrays with room for so many more blocks and planes.

    Args:
        arrays: the store.
        blocks: number of blocks that may be added.
        planes: number of blocks that may turn NARROW, or from NARROW to WIDE.
    """
    count, narrow, wide = (int(arrays.counts[i]) for i in (BLOCK_COUNT, NARROW_COUNT, WIDE_COUNT))
    needed = count + blocks
    table = arrays.table
    if len(table) < 2 * needed:
        table = np.full(max(2 * needed, len(table) * 2), -1, np.int32)
        rehash(table, arrays.keys, count)
    dirty = arrays.dirty
    return arrays._replace(
        table=table,
        keys=grown(arrays.keys, needed, used=count),
        base=grown(arrays.base, needed, 0),
        kind=grown(arrays.kind, needed, UNSEEN),
        plane=grown(arrays.plane, needed, 0),
        narrow=grown(arrays.narrow, narrow + planes, used=narrow),
        wide=grown(arrays.wide, wide + planes, used=wide),
        free_rows=grown(arrays.free_rows, narrow + planes),
        dirty=grown(dirty, needed, 0) if len(dirty) else dirty,
    )


def block_bytes(arrays: BlockArrays) -> int:
    """Memory in use by occupancy and state [bytes]; the hash table counts in full."""
    counts = arrays.counts
    per_block = BLOCK_BYTES + (DIRTY_BYTES if len(arrays.dirty) else 0)
    return int(
        arrays.table.nbytes
        + counts[BLOCK_COUNT] * per_block
        + counts[NARROW_COUNT] * PLANE_BYTES
        + counts[WIDE_COUNT] * BLOCK_VOXELS * 2
    )


@kernel
def begin_walk(x: float, y: float, z: float, dx: float, dy: float, dz: float) -> Any:
    """The voxel of a point, and what `next_voxel` needs to go on from there.

    Args:
        x: first coordinate of the point [voxels], likewise y and z.
        y: see x.
        z: see x.
        dx: first coordinate of the direction, whose length is the unit of length; likewise dy, dz.
        dy: see dx.
        dz: see dx.

    Returns:
        Index of the voxel; distance to its first crossing along each axis; the steps of the index;
        and the distance between two crossings. Each a tuple of three.
    """
    i, j, k = int(np.floor(x)), int(np.floor(y)), int(np.floor(z))
    step_x, next_x, delta_x = _axis_start(x, dx, i)
    step_y, next_y, delta_y = _axis_start(y, dy, j)
    step_z, next_z, delta_z = _axis_start(z, dz, k)
    return (
        (i, j, k),
        (next_x, next_y, next_z),
        (step_x, step_y, step_z),
        (delta_x, delta_y, delta_z),
    )


@kernel
def _axis_start(position: float, direction: float, cell: int) -> tuple[int, float, float]:
    """Step, distance to the first crossing and between two of them along one axis."""
    if direction > 0.0:
        return 1, (cell + 1 - position) / direction, 1.0 / direction
    if direction < 0.0:
        return -1, (cell - position) / direction, -1.0 / direction
    return 0, np.inf, np.inf


@kernel
def exit_distance(crossings: Any) -> float:
    """The distance to where the line leaves the voxel."""
    return min(crossings[0], min(crossings[1], crossings[2]))


@kernel
def next_voxel(voxel: Any, crossings: Any, steps: Any, deltas: Any) -> Any:
    """The next voxel and its crossings; see `begin_walk`."""
    i, j, k = voxel
    x, y, z = crossings
    leave = exit_distance(crossings)
    if x == leave:
        return (i + steps[0], j, k), (x + deltas[0], y, z)
    if y == leave:
        return (i, j + steps[1], k), (x, y + deltas[1], z)
    return (i, j, k + steps[2]), (x, y, z + deltas[2])


@inlined_kernel
def next_of_short_walk(voxel: Any, crossings: Any, steps: Any, deltas: Any) -> Any:
    """As `next_voxel`, without a branch.

    The processor cannot foresee how walks of a few voxels turn; how a long one turns, it can, and
    there this takes a third longer.
    """
    i, j, k = voxel
    x, y, z = crossings
    leave = exit_distance(crossings)
    is_x = x == leave
    is_y = (not is_x) & (y == leave)
    is_z = not (is_x | is_y)
    voxel = (
        i + (steps[0] if is_x else 0),
        j + (steps[1] if is_y else 0),
        k + (steps[2] if is_z else 0),
    )
    crossings = (
        x + (deltas[0] if is_x else 0.0),
        y + (deltas[1] if is_y else 0.0),
        z + (deltas[2] if is_z else 0.0),
    )
    return voxel, crossings
