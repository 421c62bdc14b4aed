"""Compiled operations on blocks of occupancy; layout in `infomap_ros.mapping.voxels.keys`.

Loops over a plane store to every element, changed or not: LLVM 20 miscompiles conditional int8
stores beside a reduction when it vectorises for AVX-512 (`test_blocks.py` would notice).
"""

from __future__ import annotations

from typing import Any

import numpy as np

from infomap_ros.geometry.kernel import kernel
from infomap_ros.mapping.config import SHARED_LOG_ODDS_LIMIT
from infomap_ros.mapping.voxels.keys import (
    BLOCK_COUNT,
    BLOCK_VOXELS,
    NARROW,
    NARROW_COUNT,
    NARROW_FREE,
    NARROW_UNKNOWN,
    UNIFORM,
    UNSEEN,
    WIDE,
    WIDE_COUNT,
    WIDE_UNKNOWN,
    table_slot,
)

_ALL = np.uint64(0xFFFFFFFFFFFFFFFF)


@kernel
def find_block(blocks: Any, key: int) -> int:
    """Slot of the block with this key, or -1."""
    place = table_slot(key, len(blocks.table))
    while True:
        slot = blocks.table[place]
        if slot < 0 or blocks.keys[slot] == key:
            return slot
        place += 1
        if place == len(blocks.table):
            place = 0


@kernel
def find_or_add_block(blocks: Any, key: int) -> int:
    """Slot of the block with this key, made if need be. The caller has made room."""
    place = table_slot(key, len(blocks.table))
    while True:
        slot = blocks.table[place]
        if slot < 0:
            break
        if blocks.keys[slot] == key:
            return slot
        place += 1
        if place == len(blocks.table):
            place = 0
    slot = blocks.counts[BLOCK_COUNT]
    blocks.counts[BLOCK_COUNT] = slot + 1
    blocks.table[place] = slot
    blocks.keys[slot] = key
    blocks.base[slot] = 0
    blocks.kind[slot] = UNSEEN
    return slot


@kernel
def quanta_at(blocks: Any, slot: int, local: int) -> tuple[bool, Any]:
    """Whether a voxel is known, and its evidence [quanta] (0 if unknown)."""
    kind, base, row = blocks.kind[slot], blocks.base[slot], blocks.plane[slot]
    return quanta_of(kind, base, row, blocks.narrow, blocks.wide, local)


@kernel
def quanta_of(
    kind: int, base: int, row: int, narrow: Any, wide: Any, local: int
) -> tuple[bool, Any]:
    """As `quanta_at`, from a block's kind, base and plane and the planes: quicker in a loop."""
    if kind == UNIFORM:
        return True, np.int64(base)
    if kind == NARROW:
        delta = np.int64(narrow[row, local])
        if delta != NARROW_UNKNOWN:
            return True, base + delta
    elif kind == WIDE:
        delta = np.int64(wide[row, local])
        if delta != WIDE_UNKNOWN:
            return True, base + delta
    return False, np.int64(0)


@kernel
def _new_narrow_row(blocks: Any) -> Any:
    counts = blocks.counts
    if counts[NARROW_FREE] > 0:
        counts[NARROW_FREE] -= 1
        return np.int64(blocks.free_rows[counts[NARROW_FREE]])
    row = counts[NARROW_COUNT]
    counts[NARROW_COUNT] = row + 1
    return row


@kernel
def release_narrow_row(blocks: Any, row: int) -> None:
    """Give a row of `narrow` back."""
    blocks.free_rows[blocks.counts[NARROW_FREE]] = row
    blocks.counts[NARROW_FREE] += 1


@kernel
def _delta_range(blocks: Any, slot: int) -> Any:
    """Smallest and largest delta of a NARROW block, 0 - base included if some are unknown."""
    plane = blocks.narrow[blocks.plane[slot]]
    low, high, unknown = np.int64(127), np.int64(-127), 0
    for i in range(BLOCK_VOXELS):
        delta = np.int64(plane[i])
        is_unknown = delta == NARROW_UNKNOWN
        unknown |= is_unknown
        low = min(low, np.int64(127) if is_unknown else delta)
        high = max(high, delta)
    if unknown:
        origin = -np.int64(blocks.base[slot])
        low, high = min(low, origin), max(high, origin)
    return low, high


@kernel
def widen(blocks: Any, slot: int) -> None:
    """Turn a NARROW block into a WIDE one."""
    narrow_row = np.int64(blocks.plane[slot])
    wide_row = blocks.counts[WIDE_COUNT]
    blocks.counts[WIDE_COUNT] = wide_row + 1
    for i in range(BLOCK_VOXELS):
        delta = np.int64(blocks.narrow[narrow_row, i])
        blocks.wide[wide_row, i] = WIDE_UNKNOWN if delta == NARROW_UNKNOWN else delta
    release_narrow_row(blocks, narrow_row)
    blocks.plane[slot] = wide_row
    blocks.kind[slot] = WIDE


@kernel
def make_room(blocks: Any, slot: int, down: int, up: int) -> None:
    """Give a block per-voxel storage in which every value may change by -down .. +up quanta."""
    kind = blocks.kind[slot]
    if kind < NARROW:
        row = _new_narrow_row(blocks)
        blocks.narrow[row, :] = NARROW_UNKNOWN if kind == UNSEEN else 0
        blocks.plane[slot] = row
        blocks.kind[slot] = NARROW
    if blocks.kind[slot] != NARROW:
        return
    low, high = _delta_range(blocks, slot)
    if low - down >= -127 and high + up <= 127:
        return
    if high - low + down + up <= 254:
        shift = (low - down + high + up) // 2
        plane = blocks.narrow[blocks.plane[slot]]
        for i in range(BLOCK_VOXELS):
            delta = np.int64(plane[i])
            plane[i] = delta if delta == NARROW_UNKNOWN else delta - shift
        blocks.base[slot] += shift
    else:
        widen(blocks, slot)


@kernel
def clipped(quanta: int) -> int:
    """Evidence as it is told to others [quanta]."""
    return min(max(quanta, -SHARED_LOG_ODDS_LIMIT), SHARED_LOG_ODDS_LIMIT)


@kernel
def mark_dirty(blocks: Any, slot: int, local: int) -> None:
    """Remember that a voxel changed, if changes are tracked."""
    if len(blocks.dirty):
        blocks.dirty[slot, local >> 6] |= np.uint64(1) << np.uint64(local & 63)


@kernel
def add_quanta(blocks: Any, slot: int, local: int, quanta: int) -> None:
    """Add evidence to one voxel of a block in which `make_room` has made room."""
    base = np.int64(blocks.base[slot])
    row = blocks.plane[slot]
    if blocks.kind[slot] == NARROW:
        delta = np.int64(blocks.narrow[row, local])
        known = delta != NARROW_UNKNOWN
        old = base + delta if known else np.int64(0)
        blocks.narrow[row, local] = old + quanta - base
    else:
        delta = np.int64(blocks.wide[row, local])
        known = delta != WIDE_UNKNOWN
        old = base + delta if known else np.int64(0)
        blocks.wide[row, local] = min(max(old + quanta - base, -32767), 32767)
    if not known or clipped(old + quanta) != clipped(old):
        mark_dirty(blocks, slot, local)


@kernel
def add_quanta_to_all(blocks: Any, slot: int, quanta: int) -> None:
    """Add evidence to every voxel of a block; all become known."""
    kind = blocks.kind[slot]
    base = np.int64(blocks.base[slot])
    if len(blocks.dirty) and (kind != UNIFORM or clipped(base + quanta) != clipped(base)):
        blocks.dirty[slot, :] = _ALL
    if kind == UNSEEN:
        blocks.kind[slot] = UNIFORM
    elif kind == NARROW:
        _complete_narrow(blocks, slot)
    elif kind == WIDE:
        _complete_wide(blocks, slot)
    blocks.base[slot] += quanta


@kernel
def _complete_narrow(blocks: Any, slot: int) -> None:
    """Make the unknown voxels of a NARROW block known with evidence 0; merge equal values."""
    row = np.int64(blocks.plane[slot])
    plane = blocks.narrow[row]
    origin = -np.int64(blocks.base[slot])
    low, high = np.int64(127), np.int64(-127)
    for i in range(BLOCK_VOXELS):
        delta = np.int64(plane[i])
        delta = origin if delta == NARROW_UNKNOWN else delta
        plane[i] = delta
        low, high = min(low, delta), max(high, delta)
    if low == high:
        blocks.base[slot] += low
        blocks.kind[slot] = UNIFORM
        release_narrow_row(blocks, row)


@kernel
def _complete_wide(blocks: Any, slot: int) -> None:
    """Make the unknown voxels of a WIDE block known with evidence 0."""
    plane = blocks.wide[blocks.plane[slot]]
    origin = min(max(-np.int64(blocks.base[slot]), -32767), 32767)
    for i in range(BLOCK_VOXELS):
        delta = np.int64(plane[i])
        plane[i] = origin if delta == WIDE_UNKNOWN else delta
