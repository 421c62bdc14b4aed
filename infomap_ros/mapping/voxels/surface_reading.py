"""Compiled questions to the Gaussians; layout in `infomap_ros.mapping.voxels.surface`."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit

from infomap_ros.geometry.kernel import kernel
from infomap_ros.mapping.voxels.gaussians import gaussian_of, solve_mean
from infomap_ros.mapping.voxels.keys import BLOCK_VOXELS
from infomap_ros.mapping.voxels.surface import FULL_MASK, INFORMATION_SIZE, PAGE_COUNT, SIDES
from infomap_ros.mapping.voxels.surface_code import decode_information

CODES, FULL = 0, 1
"""Kinds of records."""

_ONE, _ZERO = np.uint64(1), np.uint64(0)

_TOLERANCE = 1.2
"""How far from its voxel's centre a mean may lie, in half voxels."""


@kernel
def count_ones(word: Any) -> Any:
    """Number of ones of 64 bits."""
    pairs = word - ((word >> np.uint64(1)) & np.uint64(0x5555555555555555))
    low, high = pairs & np.uint64(0x3333333333333333), pairs >> np.uint64(2)
    fours = low + (high & np.uint64(0x3333333333333333))
    octets = (fours + (fours >> np.uint64(4))) & np.uint64(0x0F0F0F0F0F0F0F0F)
    return np.int64((octets * np.uint64(0x0101010101010101)) >> np.uint64(56))


@kernel
def rank_of(masks: Any, row: int, local: int) -> Any:
    """Number of voxels of a bit set before `local`, or -1 where its own bit is not set."""
    word, bit = local >> 6, np.uint64(local & 63)
    if not (masks[row, word] >> bit) & _ONE:
        return np.int64(-1)
    rank = count_ones(masks[row, word] & ((_ONE << bit) - _ONE))
    for before in range(word):
        rank += count_ones(masks[row, before])
    return rank


@kernel
def mask_word(surface: Any, page: int, kind: int, word: int) -> Any:
    """One of the 8 words of a page's bit set for records of a kind."""
    if kind == CODES:
        return surface.masks[page, word]
    row = np.int64(surface.starts[page, FULL_MASK])
    return surface.full_masks[row, word] if row >= 0 else _ZERO


@kernel
def copy(source: Any, target: Any) -> None:
    """Copy information, shape (9,)."""
    for i in range(INFORMATION_SIZE):
        target[i] = source[i]


@kernel
def read_record(surface: Any, record: int, information: Any) -> bool:
    """Information of a record, 512 * sheet + local index; False where there is none.

    Args:
        surface: a `SurfaceArrays`.
        record: see above.
        information: receives matrix and vector, shape (9,), float32.
    """
    if record >> 9 >= len(surface.page) or surface.page[record >> 9] < 0:
        return False
    page = np.int64(surface.page[record >> 9])
    rank = rank_of(surface.masks, page, record & 511)
    if rank >= 0:
        row = surface.starts[page, CODES] + rank
        decode_information(surface.words[row], surface.tails[row], information)
        return True
    full = np.int64(surface.starts[page, FULL_MASK])
    if full < 0:
        return False
    rank = rank_of(surface.full_masks, full, record & 511)
    if rank >= 0:
        copy(surface.information[surface.starts[page, FULL] + rank], information)
    return bool(rank >= 0)


@kernel
def read_information(
    surface: Any, slot: int, local: int, half: float, information: Any, other: Any
) -> bool:
    """What a map knows of the surface in a voxel; False where there is nothing.

    Args:
        surface: a `SurfaceArrays`.
        slot: of the voxel's block.
        local: its index in the block.
        half: half a voxel [m].
        information: receives matrix and vector, shape (9,), float32.
        other: to work with, shape (9,), float32.
    """
    record = slot * SIDES * BLOCK_VOXELS + local
    is_one = read_record(surface, record, information)
    is_other = read_record(surface, record + BLOCK_VOXELS, other)
    if is_one and is_other:
        _join(information, other, half)
    elif is_other:
        copy(other, information)
    return is_one or is_other


@kernel
def _join(information: Any, other: Any, half: float) -> None:
    """What the two sides of a voxel tell together.

    If both find the surface in the voxel it is their sum; if one does, that one: the other saw the
    far face of something thin, beyond the voxel. If none does there is no surface in the voxel.
    """
    one_lies, other_lies = _mean_lies_in(information, half), _mean_lies_in(other, half)
    for i in range(INFORMATION_SIZE):
        if one_lies and other_lies:
            information[i] += other[i]
        elif other_lies:
            information[i] = other[i]


@kernel
def _mean_lies_in(information: Any, half: float) -> bool:
    """As `lies_in_voxel`, for those who want neither covariance nor mean."""
    covariance, mean = gaussian_of(information)
    return bool(covariance[0] > 0.0 and _is_near(mean, half))


@kernel
def _is_near(mean: Any, half: float) -> bool:
    """Whether a place relative to a voxel's centre [m] lies in the voxel, with the tolerance."""
    return bool(max(abs(mean[0]), abs(mean[1]), abs(mean[2])) <= _TOLERANCE * half)


@kernel
def lies_in_voxel(information: Any, half: float, work: Any, mean: Any) -> bool:
    """Whether the mean lies in the voxel, with a tolerance of a tenth of its size.

    Args:
        information: matrix and vector, shape (9,).
        half: half a voxel [m].
        work: receives the covariance, shape (6,).
        mean: receives the mean relative to the voxel's centre, shape (3,).
    """
    return bool(solve_mean(information, work, mean) and _is_near(mean, half))


@kernel
def read_sheet(surface: Any, sheet: int, records: Any, information: Any) -> int:
    """All records of a sheet in the order of the voxels; returns how many.

    Args:
        surface: a `SurfaceArrays`.
        sheet: its number, within ``len(surface.page)``.
        records: receives 512 * sheet + local index, shape (512,).
        information: receives matrix and vector, shape (512, 9), float32.
    """
    page, first = np.int64(surface.page[sheet]), np.int64(sheet) * BLOCK_VOXELS
    if page < 0:
        return 0
    code, full = np.int64(surface.starts[page, CODES]), np.int64(surface.starts[page, FULL])
    found = 0
    for word in range(8):
        codes = mask_word(surface, page, CODES, word)
        others = mask_word(surface, page, FULL, word)
        record = first + 64 * word
        while (codes | others) != _ZERO:
            if codes & _ONE:
                decode_information(surface.words[code], surface.tails[code], information[found])
                code += 1
            elif others & _ONE:
                copy(surface.information[full], information[found])
                full += 1
            if (codes | others) & _ONE:
                records[found] = record
                found += 1
            codes, others, record = codes >> _ONE, others >> _ONE, record + 1
    return found


@njit(cache=True, nogil=True)
def read_block(
    surface: Any, slot: int, half: float, locals_: Any, information: Any, others: Any
) -> int:
    """What a map knows of the surfaces in a block, in no order; returns of how many voxels.

    Args:
        surface: a `SurfaceArrays`.
        slot: of the block.
        half: half a voxel [m].
        locals_: receives local indices, shape (1024,).
        information: receives matrix and vector, shape (1024, 9), float32.
        others: to work with, shape (512,), int64.
    """
    if SIDES * slot >= len(surface.page):
        return 0
    count = read_sheet(surface, SIDES * slot, locals_, information)
    more = read_sheet(surface, SIDES * slot + 1, locals_[count:], information[count:])
    others[:] = -1
    for row in range(count):
        locals_[row] &= BLOCK_VOXELS - 1
        others[locals_[row]] = row
    found = count
    for row in range(count, count + more):
        local = locals_[row] & (BLOCK_VOXELS - 1)
        if others[local] >= 0:
            _join(information[others[local]], information[row], half)
        else:
            locals_[found] = local
            copy(information[row], information[found])
            found += 1
    return found


@kernel
def count_records(surface: Any) -> int:
    """Number of records."""
    total = 0
    for page in range(surface.counts[PAGE_COUNT]):
        for word in range(8):
            total += count_ones(mask_word(surface, page, CODES, word))
            total += count_ones(mask_word(surface, page, FULL, word))
    return total


@njit(cache=True, nogil=True)
def list_records(surface: Any, records: Any, information: Any) -> None:
    """All records; for the arguments see `read_sheet`, there are `count_records`."""
    found = 0
    numbers = np.empty(BLOCK_VOXELS, np.int64)
    rows = np.empty((BLOCK_VOXELS, INFORMATION_SIZE), np.float32)
    for sheet in range(len(surface.page)):
        count = read_sheet(surface, sheet, numbers, rows)
        records[found : found + count] = numbers[:count]
        information[found : found + count] = rows[:count]
        found += count
