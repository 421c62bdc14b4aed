"""Storing the information of many voxels, and how much memory that takes."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from infomap_ros.mapping.voxels.keys import BLOCK_VOXELS
from infomap_ros.mapping.voxels.surface import (
    CHUNK,
    CODE_COUNT,
    CODE_GAPS,
    FULL_BYTES,
    FULL_COUNT,
    INFORMATION_SIZE,
    PAGE_BYTES,
    PAGE_COUNT,
    SurfaceArrays,
    empty_surface,
    with_pages,
    with_records,
)
from infomap_ros.mapping.voxels.surface_code import CODE_BYTES, is_isotropic
from infomap_ros.mapping.voxels.surface_reading import count_records, list_records
from infomap_ros.mapping.voxels.surface_storing import close_gaps, store_records

_MOST_GAPS, _FEW_RECORDS = 0.125, 1024
"""Share of the records, and number beside it, that may be gaps."""


def put_records(
    surface: SurfaceArrays,
    blocks: int,
    voxels: NDArray[np.int64],
    information: NDArray[np.float32],
    adding: bool,
) -> SurfaceArrays:
    """Merge information into voxels, or put it there.

    Args:
        surface: the arrays; what they hold is changed.
        blocks: number of block slots of the map.
        voxels: block slot * 512 + local index, shape (n,); each at most once.
        information: shape (n, 9); rows that begin with 0 are not merged.
        adding: whether to add to what is there, else to replace it.

    Returns:
        The arrays, larger ones where there was no room.

    Raises:
        CapacityError: there are more blocks or records than can be numbered.
    """
    order = np.empty(len(voxels), np.int64)
    used, pages = _group_by_block(
        voxels, information, adding, np.zeros(blocks + 1, np.int64), order
    )
    surface = with_pages(_without_gaps(surface), blocks, pages)
    done = 0
    while True:
        done = store_records(surface, voxels, information, order[:used], done, adding)
        if done == used:
            return surface
        surface = with_records(surface, max(BLOCK_VOXELS, used - done))


def _without_gaps(surface: SurfaceArrays) -> SurfaceArrays:
    """The arrays, or copies without gaps where blocks that grew have left too many."""
    used, gaps = surface.counts[CODE_COUNT : FULL_COUNT + 1], surface.counts[CODE_GAPS:]
    if (gaps <= _MOST_GAPS * used + _FEW_RECORDS).all():
        return surface
    empty = with_pages(empty_surface(), len(surface.page), int(surface.counts[PAGE_COUNT]))
    target = with_records(empty, int((used - gaps).max()))
    close_gaps(surface, target)
    return target


def records_of(surface: SurfaceArrays) -> tuple[NDArray[np.int64], NDArray[np.float32]]:
    """All records: voxels as block slot * 512 + local index (n,), information (n, 9)."""
    count = int(count_records(surface))
    voxels = np.empty(count, np.int64)
    information = np.empty((count, INFORMATION_SIZE), np.float32)
    list_records(surface, voxels, information)
    return voxels, information


def surface_of(
    blocks: int, voxels: NDArray[np.int64], information: NDArray[np.float32]
) -> SurfaceArrays:
    """The inverse of `records_of`, without unused room, for a map of so many blocks."""
    return put_records(empty_surface(), blocks, voxels, information, adding=False)


@njit(cache=True, nogil=True)
def _group_by_block(
    voxels: Any, information: Any, adding: bool, places: Any, order: Any
) -> tuple[int, int]:
    """Order the rows that are to be stored by block.

    Args:
        voxels: see `put_records`, likewise information and adding.
        information: see voxels.
        adding: see voxels.
        places: zeros, one more than there are blocks.
        order: receives the rows.

    Returns:
        Number of rows and of their blocks.
    """
    used, blocks = 0, 0
    for row in range(len(voxels)):
        if not adding or information[row, 0] > 0.0:
            slot = voxels[row] >> 9
            blocks += places[slot] == 0
            places[slot] += 1
            used += 1
    total = 0
    for slot in range(len(places)):
        count = places[slot]
        places[slot] = total
        total += count
    for row in range(len(voxels)):
        if not adding or information[row, 0] > 0.0:
            slot = voxels[row] >> 9
            order[places[slot]] = row
            places[slot] += 1
    return used, blocks


def growth_of_surface(
    surface: SurfaceArrays,
    slots: NDArray[np.int64],
    blocks: NDArray[np.int64],
    information: NDArray[np.float32],
) -> int:
    """What observations add to the memory of the Gaussians, at the most [bytes].

    Args:
        surface: the arrays.
        slots: of the blocks that are observed, -1 for new ones, shape (m,).
        blocks: row in `slots` of each observation, shape (n,).
        information: shape (n, 9).
    """
    fresh = np.zeros((len(slots), 2), np.int64)
    _count_kinds(blocks, information, fresh)
    pages = np.where(slots >= 0, _pages(surface, slots), -1)
    old = np.zeros((len(slots), 2), np.int64)
    _count_stored(surface.masks, pages, old)
    rooms = np.minimum((old + fresh + CHUNK - 1) // CHUNK * CHUNK, BLOCK_VOXELS)
    rooms[fresh == 0] = 0
    new_pages = int(np.count_nonzero(fresh.any(axis=1) & (pages < 0)))
    return int(rooms.sum(axis=0) @ [CODE_BYTES, FULL_BYTES]) + new_pages * PAGE_BYTES


def _pages(surface: SurfaceArrays, slots: NDArray[np.int64]) -> NDArray[np.int64]:
    known = slots < len(surface.page)
    return np.where(known, surface.page[np.where(known, slots, 0)].astype(np.int64), -1)


@njit(cache=True, nogil=True)
def _count_kinds(blocks: Any, information: Any, counts: Any) -> None:
    """Count the observations of each block that need a code, and others."""
    for row in range(len(blocks)):
        if information[row, 0] > 0.0:
            counts[blocks[row], 0 if is_isotropic(information[row]) else 1] += 1


@njit(cache=True, nogil=True)
def _count_stored(masks: Any, pages: Any, counts: Any) -> None:
    """Count the records of pages, none for -1."""
    for i in range(len(pages)):
        if pages[i] >= 0:
            for word in range(16):
                bits = masks[pages[i], word]
                while bits != np.uint64(0):
                    bits &= bits - np.uint64(1)
                    counts[i, word >> 3] += 1
