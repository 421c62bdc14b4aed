"""Storing the information of many voxels, and how much memory that takes."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from infomap_ros.geometry.kernel import kernel
from infomap_ros.mapping.voxels.keys import BLOCK_VOXELS
from infomap_ros.mapping.voxels.surface import (
    CHUNK,
    CODE_COUNT,
    CODE_GAPS,
    FULL_BYTES,
    FULL_COUNT,
    FULL_GAPS,
    INFORMATION_SIZE,
    MASK_BYTES,
    MASK_COUNT,
    PAGE_BYTES,
    PAGE_COUNT,
    SIDES,
    SurfaceArrays,
    empty_surface,
    with_pages,
    with_records,
)
from infomap_ros.mapping.voxels.surface_code import CODE_BYTES, is_isotropic
from infomap_ros.mapping.voxels.surface_pages import close_gaps
from infomap_ros.mapping.voxels.surface_reading import CODES, FULL, count_records, list_records
from infomap_ros.mapping.voxels.surface_rooms import records_in
from infomap_ros.mapping.voxels.surface_storing import arrange_records, empty_work, store_rows

_MOST_GAPS, _FEW_RECORDS = 0.125, 1024
"""Share of the records, and number beside it, that may be gaps."""


def put_records(
    surface: SurfaceArrays,
    blocks: int,
    records: NDArray[np.int64],
    information: NDArray[np.float32],
    adding: bool,
) -> SurfaceArrays:
    """Merge information into records, or put it there.

    Args:
        surface: the arrays; what they hold is changed.
        blocks: number of block slots of the map.
        records: 512 * sheet + local index, shape (n,); each at most once.
        information: shape (n, 9); rows that begin with 0 are not merged.
        adding: whether to add to what is there, else to replace it.

    Returns:
        The arrays, larger ones where there was no room.

    Raises:
        CapacityError: there are more blocks or records than can be numbered.
    """
    surface, order = with_arranged(surface, blocks, records, information, adding)
    store_rows(surface, records, information, order, 0, len(order), adding)
    return surface


def with_arranged(
    surface: SurfaceArrays,
    blocks: int,
    records: NDArray[np.int64],
    information: NDArray[np.float32],
    adding: bool,
) -> tuple[SurfaceArrays, NDArray[np.int64]]:
    """Make the records that `put_records` needs; for the arguments see there.

    Returns:
        The arrays, and the rows that are to be stored, those of a sheet side by side.
    """
    order, places = np.empty(len(records), np.int64), np.zeros(SIDES * blocks + 1, np.int64)
    used, pages = _group_by_sheet(records, information, adding, places, order)
    surface = with_pages(_without_gaps(surface), blocks, pages)
    done, order, work = 0, order[:used], empty_work()
    while True:
        done = arrange_records(surface, records, information, order, done, work)
        if done == used:
            return surface, order
        surface = with_records(surface, max(BLOCK_VOXELS, used - done))


def _without_gaps(surface: SurfaceArrays) -> SurfaceArrays:
    """The arrays, or copies without gaps where blocks that grew have left too many."""
    counts = surface.counts
    used, gaps = counts[CODE_COUNT : FULL_COUNT + 1], counts[CODE_GAPS : FULL_GAPS + 1]
    if (gaps <= _MOST_GAPS * used + _FEW_RECORDS).all():
        return surface
    pages = int(max(counts[PAGE_COUNT], counts[MASK_COUNT]))
    empty = with_pages(empty_surface(), -(-len(surface.page) // SIDES), pages)
    target = with_records(empty, int((used - gaps).max()))
    close_gaps(surface, target)
    return target


def records_of(surface: SurfaceArrays) -> tuple[NDArray[np.int64], NDArray[np.float32]]:
    """All records: 512 * sheet + local index (n,), information (n, 9)."""
    count = int(count_records(surface))
    records = np.empty(count, np.int64)
    information = np.empty((count, INFORMATION_SIZE), np.float32)
    list_records(surface, records, information)
    return records, information


def surface_of(
    blocks: int, records: NDArray[np.int64], information: NDArray[np.float32]
) -> SurfaceArrays:
    """The inverse of `records_of`, without unused room, for a map of so many blocks."""
    return put_records(empty_surface(), blocks, records, information, adding=False)


@kernel
def _group_by_sheet(
    records: Any, information: Any, adding: bool, places: Any, order: Any
) -> tuple[int, int]:
    """Order the rows that are to be stored by sheet.

    Args:
        records: see `put_records`, likewise information and adding.
        information: see records.
        adding: see records.
        places: zeros, one more than there are sheets.
        order: receives the rows.

    Returns:
        Number of rows and of their sheets.
    """
    used, sheets = 0, 0
    for row in range(len(records)):
        if not adding or information[row, 0] > 0.0:
            sheet = records[row] >> 9
            sheets += places[sheet] == 0
            places[sheet] += 1
            used += 1
    total = 0
    for sheet in range(len(places)):
        count = places[sheet]
        places[sheet] = total
        total += count
    for row in range(len(records)):
        if not adding or information[row, 0] > 0.0:
            sheet = records[row] >> 9
            order[places[sheet]] = row
            places[sheet] += 1
    return used, sheets


def growth_of_surface(
    surface: SurfaceArrays,
    sheets: NDArray[np.int64],
    places: NDArray[np.int64],
    information: NDArray[np.float32],
) -> int:
    """What observations add to the memory of the Gaussians, at the most [bytes].

    Args:
        surface: the arrays.
        sheets: that are observed, negative for those of new blocks, shape (m,).
        places: row in `sheets` of each observation, shape (n,).
        information: shape (n, 9).
    """
    fresh = np.zeros((len(sheets), 2), np.int64)
    _count_kinds(places, information, fresh)
    pages = _pages(surface, sheets)
    old = np.zeros((len(sheets), 2), np.int64)
    _count_stored(surface, pages, old)
    rooms = np.minimum((old + fresh + CHUNK - 1) // CHUNK * CHUNK, BLOCK_VOXELS)
    rooms[fresh == 0] = 0
    new_pages = int(np.count_nonzero(fresh.any(axis=1) & (pages < 0)))
    new_masks = int(np.count_nonzero((fresh[:, 1] > 0) & (old[:, 1] == 0)))
    pages_bytes = new_pages * PAGE_BYTES + new_masks * MASK_BYTES
    return int(rooms.sum(axis=0) @ [CODE_BYTES, FULL_BYTES]) + pages_bytes


def _pages(surface: SurfaceArrays, sheets: NDArray[np.int64]) -> NDArray[np.int64]:
    known = (sheets >= 0) & (sheets < len(surface.page))
    return np.where(known, surface.page[np.where(known, sheets, 0)].astype(np.int64), -1)


@kernel
def _count_kinds(places: Any, information: Any, counts: Any) -> None:
    """Count the observations of each sheet that need a code, and others."""
    for row in range(len(places)):
        if information[row, 0] > 0.0:
            counts[places[row], 0 if is_isotropic(information[row]) else 1] += 1


@kernel
def _count_stored(surface: Any, pages: Any, counts: Any) -> None:
    """Count the records of pages, none for -1."""
    for i in range(len(pages)):
        if pages[i] >= 0:
            counts[i, CODES] = records_in(surface, pages[i], CODES)
            counts[i, FULL] = records_in(surface, pages[i], FULL)
