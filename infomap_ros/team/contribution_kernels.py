"""Compiled operations on one robot's contribution; layout in `infomap_ros.team.contribution`."""

from __future__ import annotations

from typing import Any

import numpy as np

from infomap_ros.geometry.kernel import kernel
from infomap_ros.mapping.config import NOT_OBSERVED
from infomap_ros.mapping.voxels.block_kernels import find_block, find_or_add_block
from infomap_ros.mapping.voxels.keys import (
    BLOCK_BITS,
    BLOCK_COUNT,
    BLOCK_SIDE,
    BLOCK_VOXELS,
    local_index,
    pack,
    unpack,
)
from infomap_ros.team.gaussian_code import code_row, find_row, information_of_code
from infomap_ros.team.update import is_newer

_ZERO = np.uint64(0)


@kernel
def mixed(value: Any) -> Any:
    """A word whose bits all depend on all bits of another (the finaliser of SplitMix64)."""
    x = np.uint64(value) + np.uint64(0x9E3779B97F4A7C15)
    x = (x ^ (x >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    x = (x ^ (x >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return x ^ (x >> np.uint64(31))


@kernel
def _state_hash(local: int, log_odds: int, code: Any, other: Any) -> Any:
    """Hash of a voxel's state, 0 where it is not observed."""
    if log_odds == NOT_OBSERVED:
        return _ZERO
    place = np.uint64(local) | (np.uint64(np.int64(log_odds) & 0xFF) << np.uint64(16))
    return mixed(mixed(mixed(place) ^ code) ^ other)


@kernel
def block_hash(key: Any, content: Any) -> Any:
    """Hash of a block with this key and the sum of its states' hashes; 0 where it is empty."""
    return _ZERO if content == _ZERO else mixed(mixed(np.uint64(key)) ^ content)


@kernel
def accept_states(
    blocks: Any,
    planes: Any,
    codes: Any,
    indices: Any,
    versions: Any,
    log_odds: Any,
    words: Any,
    first: int,
    changed: Any,
) -> int:
    """Keep the states that are newer, from row `first` on.

    Args:
        blocks: `BlockArrays` with room for all blocks.
        planes: `Planes` with room for all blocks.
        codes: a `CodeTable`.
        indices: of the voxels, shape (K, 3).
        versions: shape (K,).
        log_odds: shape (K,).
        words: codes of the surface points, shape (K, 2).
        first: see above.
        changed: receives which states are other than before, shape (K,).

    Returns:
        The row before which the table of codes is full, or K.
    """
    known, evidence, newest, hashes = planes.versions, planes.log_odds, planes.newest, planes.hashes
    table, owner, counts, stored = codes.table, codes.owner, codes.counts, codes.codes
    last_key, slot = np.int64(-1), np.int64(-1)
    for row in range(first, len(versions)):
        x, y, z = indices[row, 0], indices[row, 1], indices[row, 2]
        key = pack(x >> BLOCK_BITS, y >> BLOCK_BITS, z >> BLOCK_BITS)
        if key != last_key:
            slot, last_key = np.int64(find_or_add_block(blocks, key)), key
        local, version = local_index(x, y, z), versions[row]
        if not is_newer(version, known[slot, local]):
            continue
        place = find_row(table, owner, slot * BLOCK_VOXELS + local)
        if place < 0 and words[row, 1] != _ZERO:
            place = code_row(table, owner, counts, slot * BLOCK_VOXELS + local, stored)
            if place < 0:
                return row
        known[slot, local] = version
        if is_newer(version, newest[slot]):
            newest[slot] = version
        code, other = _ZERO, _ZERO
        if place >= 0:
            code, other = stored[place, 0], stored[place, 1]
        same_code = code == words[row, 0] and other == words[row, 1]
        if evidence[slot, local] == log_odds[row] and same_code:
            continue
        changed[row] = True
        hashes[slot] -= _state_hash(local, evidence[slot, local], code, other)
        hashes[slot] += _state_hash(local, log_odds[row], words[row, 0], words[row, 1])
        evidence[slot, local] = log_odds[row]
        if place >= 0:
            stored[place, 0], stored[place, 1] = words[row, 0], words[row, 1]
    return len(versions)


@kernel
def count_new_codes(blocks: Any, codes: Any, indices: Any, words: Any) -> int:
    """Number of surface points (K, 3), with their codes (K, 2), that have no row yet."""
    count, last_key, slot = 0, np.int64(-1), np.int64(-1)
    for row in range(len(indices)):
        if words[row, 1] == _ZERO:
            continue
        x, y, z = indices[row, 0], indices[row, 1], indices[row, 2]
        key = pack(x >> BLOCK_BITS, y >> BLOCK_BITS, z >> BLOCK_BITS)
        if key != last_key:
            slot, last_key = np.int64(find_block(blocks, key)), key
        own = slot * BLOCK_VOXELS + local_index(x, y, z)
        if slot < 0 or find_row(codes.table, codes.owner, own) < 0:
            count += 1
    return count


@kernel
def add_contribution(
    blocks: Any,
    planes: Any,
    codes: Any,
    size: float,
    tables: Any,
    indices: Any,
    known: Any,
    quanta: Any,
    information: Any,
    work: Any,
) -> None:
    """Add what a robot knows of some voxels to sums.

    Args:
        blocks: of the contribution, as in `accept_states`.
        planes: likewise.
        codes: likewise.
        size: edge of a voxel [m].
        tables: `gaussian_code.code_tables()`.
        indices: of the voxels, shape (K, 3).
        known: whether any robot knows them, shape (K,).
        quanta: sums of the evidence, shape (K,).
        information: sums of the information, shape (K, 9), double precision.
        work: scratch, shape (5, 3).
    """
    table, owner, stored = codes.table, codes.owner, codes.codes
    last_key, slot = np.int64(-1), np.int64(-1)
    for row in range(len(quanta)):
        x, y, z = indices[row, 0], indices[row, 1], indices[row, 2]
        key = pack(x >> BLOCK_BITS, y >> BLOCK_BITS, z >> BLOCK_BITS)
        if key != last_key:
            slot, last_key = np.int64(find_block(blocks, key)), key
        if slot < 0:
            continue
        local = local_index(x, y, z)
        value = planes.log_odds[slot, local]
        if value == NOT_OBSERVED:
            continue
        known[row] = True
        quanta[row] += value
        place = find_row(table, owner, slot * BLOCK_VOXELS + local)
        if place >= 0 and stored[place, 1] != _ZERO:
            information_of_code(
                stored[place, 0], stored[place, 1], size, tables, work, information[row]
            )


@kernel
def count_known(planes: Any, slots: Any) -> int:
    """Number of voxels of some blocks of which a state was sent."""
    total = 0
    for slot in slots:
        for local in range(BLOCK_VOXELS):
            total += planes.versions[slot, local] != 0
    return total


@kernel
def list_known(
    blocks: Any,
    planes: Any,
    codes: Any,
    slots: Any,
    indices: Any,
    versions: Any,
    log_odds: Any,
    words: Any,
) -> None:
    """List the states of some blocks, those that are not observed any more included."""
    found = 0
    for slot in slots:
        x, y, z = unpack(blocks.keys[slot])
        for local in range(BLOCK_VOXELS):
            if planes.versions[slot, local] == 0:
                continue
            indices[found, 0] = x * BLOCK_SIDE + (local & 7)
            indices[found, 1] = y * BLOCK_SIDE + ((local >> 3) & 7)
            indices[found, 2] = z * BLOCK_SIDE + (local >> 6)
            versions[found] = planes.versions[slot, local]
            log_odds[found] = planes.log_odds[slot, local]
            place = find_row(codes.table, codes.owner, slot * BLOCK_VOXELS + local)
            if place >= 0:
                words[found, 0] = codes.codes[place, 0]
                words[found, 1] = codes.codes[place, 1]
            found += 1


@kernel
def hash_blocks(blocks: Any, planes: Any, hashes: Any) -> None:
    """Hash of each block, see `block_hash`."""
    for slot in range(blocks.counts[BLOCK_COUNT]):
        hashes[slot] = block_hash(blocks.keys[slot], planes.hashes[slot])


@kernel
def find_blocks(blocks: Any, coordinates: Any, slots: Any) -> None:
    """Slots of blocks with coordinates (n, 3), -1 where there is none."""
    for row in range(len(coordinates)):
        key = pack(coordinates[row, 0], coordinates[row, 1], coordinates[row, 2])
        slots[row] = find_block(blocks, key)


@kernel
def unpack_keys(keys: Any, coordinates: Any) -> None:
    """Coordinates (n, 3) of packed keys."""
    for row in range(len(keys)):
        x, y, z = unpack(keys[row])
        coordinates[row, 0], coordinates[row, 1], coordinates[row, 2] = x, y, z


@kernel
def hash_some(blocks: Any, planes: Any, slots: Any, hashes: Any) -> None:
    """As `hash_blocks`, of some blocks; 0 where the slot is -1."""
    for row in range(len(slots)):
        slot = slots[row]
        hashes[row] = _ZERO
        if slot >= 0:
            hashes[row] = block_hash(blocks.keys[slot], planes.hashes[slot])


@kernel
def list_blocks(indices: Any, coordinates: Any) -> None:
    """Coordinates of the blocks of voxels (K, 3), one for each time the block changes on the way.

    Args:
        indices: of the voxels, shape (K, 3).
        coordinates: receives those of the blocks, shape (n, 3) with n `count_block_changes`.
    """
    found, last = 0, np.int64(-1)
    for row in range(len(indices)):
        x, y, z = (
            indices[row, 0] >> BLOCK_BITS,
            indices[row, 1] >> BLOCK_BITS,
            indices[row, 2] >> BLOCK_BITS,
        )
        key = pack(x, y, z)
        if key != last:
            coordinates[found, 0], coordinates[found, 1], coordinates[found, 2] = x, y, z
            found, last = found + 1, key
