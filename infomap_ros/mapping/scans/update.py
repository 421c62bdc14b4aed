"""Writing a scan into the map: evidence into blocks, observations into Gaussians.

Each voxel changes at most once per scan: by its hit where the scan saw a surface in it, else by a
miss where the scan saw through it.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from infomap_ros.geometry.kernel import kernel
from infomap_ros.mapping.voxels.block_kernels import (
    add_quanta,
    add_quanta_to_all,
    clipped,
    find_block,
    find_or_add_block,
    make_room,
)
from infomap_ros.mapping.voxels.keys import (
    BLOCK_BITS,
    BLOCK_VOXELS,
    NARROW,
    NARROW_UNKNOWN,
    local_index,
    pack,
    unpack,
)
from infomap_ros.mapping.voxels.surface import admit_hit, admit_misses
from infomap_ros.mapping.voxels.surface_kernels import SIDES

_ONE = np.uint64(1)
_ALL = np.uint64(0xFFFFFFFFFFFFFFFF)


@kernel
def enter_rows(
    blocks: Any,
    rows: Any,
    hits: Any,
    information: Any,
    sides: Any,
    hit_blocks: int,
    hit_row: Any,
    hit_bits: Any,
    owners: Any,
    witnesses: Any,
    down: int,
    up: int,
) -> int:
    """Make the blocks of a scan's rows and add the hits.

    Args:
        blocks: a `BlockArrays` with room for a block and a plane per row.
        rows: a `ScanRows`.
        hits: evidence of each row [quanta].
        information: of each row, shape (n, 9); one that begins with 0 is none.
        sides: from which the surface is seen.
        hit_blocks: number of blocks that have a hit already.
        hit_row: per block the row of `hit_bits` or -1.
        hit_bits: receives a bit per voxel with a hit, uint64, shape (n, 8).
        owners: receives the record of each row in the `SurfaceArrays`, int64; 0 where
            there is neither evidence nor information.
        witnesses: a `WitnessArrays`; hits beyond its limit bring no evidence.
        down: largest decrease of a voxel in this scan [quanta].
        up: largest increase of a voxel in this scan [quanta].

    Returns:
        Number of blocks with a hit.
    """
    last_key, slot = np.int64(-1), np.int64(-1)
    kind, base, plane, narrow = blocks.kind, blocks.base, blocks.plane, blocks.narrow
    tracked = len(blocks.dirty) > 0
    for row in range(rows.used[0]):
        owners[row] = 0
        if hits[row] == 0 and information[row, 0] == 0.0:
            continue
        x, y, z = unpack(rows.keys[row])
        key = pack(x >> BLOCK_BITS, y >> BLOCK_BITS, z >> BLOCK_BITS)
        if key != last_key:
            slot = np.int64(find_or_add_block(blocks, key))
            last_key = key
        local = local_index(x, y, z)
        owners[row] = (slot * SIDES + sides[row]) * BLOCK_VOXELS + local
        if hits[row] == 0:
            continue
        if hit_row[slot] < 0:
            hit_row[slot] = hit_blocks
            for word in range(BLOCK_VOXELS // 64):
                hit_bits[hit_blocks, word] = 0
            hit_blocks += 1
            make_room(blocks, slot, down, up)
        hit_bits[hit_row[slot], local >> 6] |= _ONE << np.uint64(local & 63)
        if not admit_hit(witnesses, slot, local):
            continue
        if kind[slot] == NARROW and not tracked:
            delta = narrow[plane[slot], local]
            old = -base[slot] if delta == NARROW_UNKNOWN else np.int32(delta)
            narrow[plane[slot], local] = old + hits[row]
        else:
            add_quanta(blocks, slot, local, hits[row])
    return hit_blocks


@kernel
def mark_merged(dirty: Any, owners: Any, information: Any) -> None:
    """Remember that voxels receive information, if changes are tracked."""
    if len(dirty) == 0:
        return
    for row in range(len(owners)):
        if information[row, 0] > 0.0:
            bit = np.uint64(owners[row] & 63)
            dirty[owners[row] >> 10, (owners[row] & 511) >> 6] |= _ONE << bit


@kernel
def block_keys(rows: Any, keys: Any, locals_: Any) -> None:
    """Keys of the blocks in which the rows of a scan lie, and their indices in there."""
    for row in range(len(keys)):
        x, y, z = unpack(rows.keys[row])
        keys[row] = pack(x >> BLOCK_BITS, y >> BLOCK_BITS, z >> BLOCK_BITS)
        locals_[row] = local_index(x, y, z)


@kernel
def free_voxels(
    blocks: Any,
    coordinates: Any,
    bits: Any,
    hit_row: Any,
    hit_bits: Any,
    witnesses: Any,
    miss: int,
) -> None:
    """Add a miss to every voxel that the scan sees through and does not hit.

    Args:
        blocks: a `BlockArrays` with room for `count` blocks and planes.
        coordinates: of the blocks, shape (n, 3).
        bits: free voxels of each block, uint64, shape (n, 8); those of which the evidence does not
            change are taken out.
        hit_row: per block the row of `hit_bits` or -1.
        hit_bits: voxels with a hit.
        witnesses: a `WitnessArrays`; misses beyond its limit bring no evidence.
        miss: evidence of a miss [quanta].
    """
    for i in range(len(bits)):
        anything, everything = np.uint64(0), _ALL
        for word in range(8):
            anything |= bits[i, word]
        if anything == 0:
            continue
        key = pack(coordinates[i, 0], coordinates[i, 1], coordinates[i, 2])
        slot = find_or_add_block(blocks, key)
        if hit_row[slot] >= 0:
            for word in range(8):
                bits[i, word] &= ~hit_bits[hit_row[slot], word]
        admit_misses(witnesses, slot, bits[i])
        anything = np.uint64(0)
        for word in range(8):
            anything |= bits[i, word]
            everything &= bits[i, word]
        if everything == _ALL:
            add_quanta_to_all(blocks, slot, miss)
        elif anything:
            make_room(blocks, slot, -miss, 0)
            _free_some(blocks, slot, bits[i], miss)


@kernel
def _free_some(blocks: Any, slot: int, bits: Any, miss: int) -> None:
    """Add a miss to the voxels of a block whose bits are set."""
    if blocks.kind[slot] != NARROW:
        for local in range(BLOCK_VOXELS):
            if (bits[local >> 6] >> np.uint64(local & 63)) & _ONE:
                add_quanta(blocks, slot, local, miss)
        return
    plane = blocks.narrow[blocks.plane[slot]]
    base = np.int64(blocks.base[slot])
    if len(blocks.dirty):
        _mark_freed(blocks.dirty[slot], plane, base, bits, miss)
    origin, step = np.int8(-base), np.int8(miss)
    for word in range(8):
        pattern = bits[word]
        for i in range(64):
            delta = plane[word * 64 + i]
            old = origin if delta == NARROW_UNKNOWN else delta
            is_free = (pattern >> np.uint64(i)) & _ONE
            plane[word * 64 + i] = np.int8(old + step) if is_free else delta


@kernel
def _mark_freed(dirty: Any, plane: Any, base: int, bits: Any, miss: int) -> None:
    """Mark the voxels of a NARROW block that a miss will change."""
    for word in range(8):
        pattern, changed = bits[word], np.uint64(0)
        for i in range(64):
            delta = np.int64(plane[word * 64 + i])
            is_changed = clipped(base + delta) != clipped(base + delta + miss)
            if delta == NARROW_UNKNOWN or is_changed:
                changed |= _ONE << np.uint64(i)
        dirty[word] |= changed & pattern


@kernel
def count_new_by_rows(blocks: Any, rows: Any, hits: Any, counts: Any) -> None:
    """Count blocks and planes that the rows of a scan would make; at most, not exactly.

    Args:
        blocks: a `BlockArrays`.
        rows: a `ScanRows`.
        hits: evidence of each row [quanta].
        counts: number of blocks and of planes; increased.
    """
    last_key, last_plane = np.int64(-1), np.int64(-1)
    for row in range(rows.used[0]):
        x, y, z = unpack(rows.keys[row])
        key = pack(x >> BLOCK_BITS, y >> BLOCK_BITS, z >> BLOCK_BITS)
        slot = find_block(blocks, key)
        if key != last_key and slot < 0:
            counts[0] += 1
        last_key = key
        if hits[row] != 0 and key != last_plane:
            last_plane = key
            counts[1] += slot < 0 or blocks.kind[slot] < NARROW


@kernel
def count_new_by_free(blocks: Any, coordinates: Any, bits: Any, counts: Any) -> None:
    """Count blocks and planes that the free voxels of a scan would make, as `count_new_by_rows`."""
    for i in range(len(bits)):
        anything, everything = np.uint64(0), _ALL
        for word in range(8):
            anything |= bits[i, word]
            everything &= bits[i, word]
        if anything == 0:
            continue
        key = pack(coordinates[i, 0], coordinates[i, 1], coordinates[i, 2])
        slot = find_block(blocks, key)
        counts[0] += slot < 0
        counts[1] += everything != _ALL and (slot < 0 or blocks.kind[slot] < NARROW)
