"""Exchanging blocks of a map for those of another map, in new arrays without gaps.

Blocks keep their numbers, and what becomes other than before counts as changed: also a voxel that
was known and is no more.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from infomap_ros.mapping.voxels.block_kernels import (
    clipped,
    find_block,
    find_or_add_block,
    mark_dirty,
    quanta_at,
)
from infomap_ros.mapping.voxels.keys import (
    BLOCK_COUNT,
    BLOCK_VOXELS,
    NARROW,
    NARROW_COUNT,
    WIDE,
    WIDE_COUNT,
    BlockArrays,
    empty_blocks,
    with_room,
)
from infomap_ros.mapping.voxels.storage import MapStorage
from infomap_ros.mapping.voxels.surface import SurfaceArrays, records_of, surface_of
from infomap_ros.mapping.voxels.surface_kernels import EXCESS, ROW_SIZE, SIDES, read_record


def exchange_blocks(
    storage: MapStorage, other: MapStorage, chosen: NDArray[np.bool_]
) -> MapStorage:
    """The map with some blocks as another one has them.

    Args:
        storage: the map.
        other: where the chosen blocks come from; one that it lacks becomes unknown. Its blocks
            that the map does not have at all are added, others are left alone.
        chosen: of the map's blocks, shape (blocks,).

    Returns:
        New arrays; the map is as it was.
    """
    old, new = storage.blocks, other.blocks
    new_slots = _slots_of(old, new, chosen)
    blocks = _exchanged(old, new, chosen, new_slots)
    surface = storage.gaussians, other.gaussians
    gaussians = _chosen_gaussians(*surface, chosen, new_slots, len(blocks.keys))
    gone = np.zeros((len(chosen), 8), np.uint64)
    gone[: len(storage.gone)] = storage.gone
    _mark_gone(old, blocks, chosen, gone)
    if len(old.dirty):
        _mark_changes(old, storage.gaussians, blocks, gaussians, chosen)
    return MapStorage(blocks, gaussians, gone, storage.offset)


def _slots_of(old: BlockArrays, new: BlockArrays, chosen: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Where the blocks of `new` go in the exchanged map, -1 for those that are left alone."""
    slots = np.empty(int(new.counts[BLOCK_COUNT]), np.int64)
    _find_slots(old, new, chosen, slots)
    return slots


def _exchanged(
    old: BlockArrays, new: BlockArrays, chosen: NDArray[np.bool_], new_slots: NDArray[np.int64]
) -> BlockArrays:
    count = int(old.counts[BLOCK_COUNT])
    added = int(np.count_nonzero(new_slots >= count))
    empty = empty_blocks()
    if len(old.dirty):
        empty = empty._replace(dirty=np.zeros((len(empty.keys), 8), np.uint64))
    planes = [int(source.counts[i]) for source in (old, new) for i in (NARROW_COUNT, WIDE_COUNT)]
    blocks = with_room(empty, count + added, sum(planes))
    _copy_blocks(old, new, chosen, new_slots, blocks)
    if len(old.dirty):
        blocks.dirty[:count] = old.dirty[:count]
    return blocks


def _chosen_gaussians(
    old: SurfaceArrays,
    new: SurfaceArrays,
    chosen: NDArray[np.bool_],
    new_slots: NDArray[np.int64],
    blocks: int,
) -> SurfaceArrays:
    (old_records, old_rows), (records, rows) = records_of(old), records_of(new)
    per_block = SIDES * BLOCK_VOXELS
    kept = ~chosen[old_records // per_block]
    slots = new_slots[records // per_block]
    taken = slots >= 0
    moved = slots[taken] * per_block + records[taken] % per_block
    return surface_of(
        blocks,
        np.concatenate([old_records[kept], moved]),
        np.concatenate([old_rows[kept], rows[taken]]),
    )


@njit(cache=True, nogil=True)
def _find_slots(old: Any, new: Any, chosen: Any, slots: Any) -> None:
    """See `_slots_of`."""
    next_slot = np.int64(old.counts[BLOCK_COUNT])
    for i in range(len(slots)):
        slot = np.int64(find_block(old, new.keys[i]))
        if slot < 0:
            slots[i] = next_slot
            next_slot += 1
        else:
            slots[i] = slot if chosen[slot] else -1


@njit(cache=True, nogil=True)
def _copy_blocks(old: Any, new: Any, chosen: Any, new_slots: Any, blocks: Any) -> None:
    """Fill empty `blocks`: the old ones in their order, the new ones in their places."""
    for slot in range(len(chosen)):
        find_or_add_block(blocks, old.keys[slot])
        if not chosen[slot]:
            _copy_block(old, slot, blocks, slot)
    for i in range(len(new_slots)):
        if new_slots[i] >= len(chosen):
            find_or_add_block(blocks, new.keys[i])
        if new_slots[i] >= 0:
            _copy_block(new, i, blocks, new_slots[i])


@njit(cache=True, nogil=True)
def _copy_block(source: Any, slot: int, target: Any, place: int) -> None:
    """Copy the voxels of one block into one that holds none yet."""
    kind = source.kind[slot]
    target.kind[place], target.base[place] = kind, source.base[slot]
    if kind == NARROW:
        row = target.counts[NARROW_COUNT]
        target.counts[NARROW_COUNT] = row + 1
        target.narrow[row, :] = source.narrow[source.plane[slot], :]
        target.plane[place] = row
    elif kind == WIDE:
        row = target.counts[WIDE_COUNT]
        target.counts[WIDE_COUNT] = row + 1
        target.wide[row, :] = source.wide[source.plane[slot], :]
        target.plane[place] = row


@njit(cache=True, nogil=True)
def _mark_changes(old: Any, old_gaussians: Any, blocks: Any, gaussians: Any, chosen: Any) -> None:
    """Mark the voxels of which the exchanged blocks say something else to others than before."""
    for slot in range(blocks.counts[BLOCK_COUNT]):
        is_new = slot >= len(chosen)
        if not is_new and not chosen[slot]:
            continue
        for local in range(BLOCK_VOXELS):
            known, quanta = quanta_at(blocks, slot, local)
            was_known, were = False, np.int64(0)
            if not is_new:
                was_known, were = quanta_at(old, slot, local)
            if known != was_known or clipped(quanta) != clipped(were):
                mark_dirty(blocks, slot, local)
            elif known and quanta > 0 and not is_new:
                voxel = slot * BLOCK_VOXELS + local
                if _differ(old_gaussians, gaussians, voxel):
                    mark_dirty(blocks, slot, local)
            elif known and is_new:
                mark_dirty(blocks, slot, local)


@njit(cache=True, nogil=True)
def _mark_gone(old: Any, blocks: Any, chosen: Any, gone: Any) -> None:
    """Mark the voxels that were known and are no more."""
    for slot in range(len(chosen)):
        if not chosen[slot]:
            continue
        for local in range(BLOCK_VOXELS):
            known, _ = quanta_at(blocks, slot, local)
            was_known, _ = quanta_at(old, slot, local)
            if was_known and not known:
                gone[slot, local >> 6] |= np.uint64(1) << np.uint64(local & 63)


@njit(cache=True, nogil=True)
def _differ(first: Any, second: Any, voxel: int) -> bool:
    """Whether the Gaussians of a voxel are not the same bits in two maps."""
    one, other = np.empty((2, ROW_SIZE), np.float32)
    record = (voxel >> 9) * SIDES * BLOCK_VOXELS + (voxel & 511)
    same = True
    for side in range(SIDES):
        one[:], other[:] = 0.0, 0.0
        read_record(first, record + side * BLOCK_VOXELS, one)
        read_record(second, record + side * BLOCK_VOXELS, other)
        for i in range(EXCESS + 1):
            same &= one[i] == other[i]
    return not same
