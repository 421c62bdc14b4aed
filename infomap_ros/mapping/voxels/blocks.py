"""Sparse occupancy: blocks of 8 x 8 x 8 voxels in a hash table.

The evidence of a voxel is an exact integer, ``base of the block + delta of the voxel`` in log-odds
quanta, so sums do not depend on their order. A block stores only what it needs:

- UNIFORM: every voxel is known and has the value ``base``; no per-voxel storage. A block that a
  scan sees through entirely costs one addition.
- NARROW: one int8 delta per voxel.
- WIDE: one int16 delta per voxel, for blocks whose values differ by more than 254 quanta.

The smallest number of each type means "never observed". A value saturates at +-32767 quanta from
the base, 8000 nats, far beyond what a probability can express.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from infomap_ros.mapping.voxels.keys import BLOCK_VOXELS, rehash

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
