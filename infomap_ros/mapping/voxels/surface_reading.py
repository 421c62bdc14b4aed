"""Compiled questions to the Gaussians; layout in `infomap_ros.mapping.voxels.surface`."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit

from infomap_ros.mapping.voxels.keys import BLOCK_VOXELS
from infomap_ros.mapping.voxels.surface import INFORMATION_SIZE, PAGE_COUNT
from infomap_ros.mapping.voxels.surface_code import decode_information

CODES, FULL = 0, 1
"""Kinds of records."""

_ONE, _ZERO = np.uint64(1), np.uint64(0)


@njit(cache=True, nogil=True)
def count_ones(word: Any) -> Any:
    """Number of ones of 64 bits."""
    pairs = word - ((word >> np.uint64(1)) & np.uint64(0x5555555555555555))
    low, high = pairs & np.uint64(0x3333333333333333), pairs >> np.uint64(2)
    fours = low + (high & np.uint64(0x3333333333333333))
    octets = (fours + (fours >> np.uint64(4))) & np.uint64(0x0F0F0F0F0F0F0F0F)
    return np.int64((octets * np.uint64(0x0101010101010101)) >> np.uint64(56))


@njit(cache=True, nogil=True)
def rank_of(masks: Any, page: int, kind: int, local: int) -> Any:
    """Number of voxels of a page's bit set before `local`, or -1 where its own bit is not set."""
    word, bit = 8 * kind + (local >> 6), np.uint64(local & 63)
    if not (masks[page, word] >> bit) & _ONE:
        return np.int64(-1)
    rank = count_ones(masks[page, word] & ((_ONE << bit) - _ONE))
    for before in range(8 * kind, word):
        rank += count_ones(masks[page, before])
    return rank


@njit(cache=True, nogil=True)
def read_information(surface: Any, voxel: int, information: Any) -> bool:
    """Information of a voxel, block slot * 512 + local index; False where there is none.

    Args:
        surface: a `SurfaceArrays`.
        voxel: see above.
        information: receives matrix and vector, shape (9,), float32.
    """
    if voxel >> 9 >= len(surface.page) or surface.page[voxel >> 9] < 0:
        return False
    page = np.int64(surface.page[voxel >> 9])
    rank = rank_of(surface.masks, page, CODES, voxel & 511)
    if rank >= 0:
        row = surface.starts[page, CODES] + rank
        decode_information(surface.words[row], surface.tails[row], information)
        return True
    rank = rank_of(surface.masks, page, FULL, voxel & 511)
    if rank >= 0:
        information[:] = surface.information[surface.starts[page, FULL] + rank]
    return bool(rank >= 0)


@njit(cache=True, nogil=True)
def read_block(surface: Any, slot: int, voxels: Any, information: Any) -> int:
    """All records of a block in the order of its voxels; returns how many.

    Args:
        surface: a `SurfaceArrays`.
        slot: of the block, within ``len(surface.page)``.
        voxels: receives block slot * 512 + local index, shape (512,).
        information: receives matrix and vector, shape (512, 9), float32.
    """
    page, first = np.int64(surface.page[slot]), np.int64(slot) * BLOCK_VOXELS
    if page < 0:
        return 0
    code, full = np.int64(surface.starts[page, CODES]), np.int64(surface.starts[page, FULL])
    found = 0
    for word in range(8):
        codes, others = surface.masks[page, word], surface.masks[page, 8 + word]
        local = first + 64 * word
        while (codes | others) != _ZERO:
            if codes & _ONE:
                decode_information(surface.words[code], surface.tails[code], information[found])
                code += 1
            elif others & _ONE:
                information[found, :] = surface.information[full]
                full += 1
            if (codes | others) & _ONE:
                voxels[found] = local
                found += 1
            codes, others, local = codes >> _ONE, others >> _ONE, local + 1
    return found


@njit(cache=True, nogil=True)
def count_records(surface: Any) -> int:
    """Number of voxels with a record."""
    total = 0
    for page in range(surface.counts[PAGE_COUNT]):
        for word in range(16):
            total += count_ones(surface.masks[page, word])
    return total


@njit(cache=True, nogil=True)
def list_records(surface: Any, voxels: Any, information: Any) -> None:
    """All records; for the arguments see `read_block`, there are `count_records`."""
    found = 0
    block_voxels = np.empty(BLOCK_VOXELS, np.int64)
    block_information = np.empty((BLOCK_VOXELS, INFORMATION_SIZE), np.float32)
    for slot in range(len(surface.page)):
        count = read_block(surface, slot, block_voxels, block_information)
        voxels[found : found + count] = block_voxels[:count]
        information[found : found + count] = block_information[:count]
        found += count
