"""Compiled storing of Gaussians; layout in `infomap_ros.mapping.voxels.surface`."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit

from infomap_ros.mapping.voxels.keys import BLOCK_VOXELS
from infomap_ros.mapping.voxels.surface import (
    CHUNK,
    CODE_COUNT,
    CODE_GAPS,
    INFORMATION_SIZE,
    PAGE_COUNT,
)
from infomap_ros.mapping.voxels.surface_code import (
    decode,
    decode_information,
    encode,
    encode_information,
    is_isotropic,
)
from infomap_ros.mapping.voxels.surface_reading import CODES, FULL, count_ones, rank_of

_ONE, _ZERO = np.uint64(1), np.uint64(0)


@njit(cache=True, nogil=True)
def canonical(information: Any) -> None:
    """Round information, shape (9,), to what a map can hold."""
    if is_isotropic(information):
        word, tail = encode_information(information)
        decode_information(word, tail, information)


@njit(cache=True, nogil=True)
def store_records(
    surface: Any, records: Any, information: Any, order: Any, first: int, adding: bool
) -> int:
    """Merge information into records, or put it there.

    Args:
        surface: a `SurfaceArrays` with a page to spare for every sheet.
        records: 512 * sheet + local index of each row, int64; each at most once.
        information: shape (n, 9), float32.
        order: the rows that are stored, those of one sheet side by side.
        first: place in `order` where to begin.
        adding: whether to add to what is there, else to replace it.

    Returns:
        Place in `order` before which room for records ran out, or its length.
    """
    work = (
        np.empty(BLOCK_VOXELS, np.uint64),
        np.empty(BLOCK_VOXELS, np.uint16),
        np.empty((BLOCK_VOXELS, INFORMATION_SIZE), np.float32),
    )
    wanted = np.empty(16, np.uint64)
    while first < len(order):
        sheet, last = records[order[first]] >> 9, first + 1
        while last < len(order) and records[order[last]] >> 9 == sheet:
            last += 1
        page = _page_of(surface, sheet)
        _want(surface.masks, page, records, information, order[first:last], wanted)
        if not _arrange(surface, page, wanted, work):
            return first
        for row in order[first:last]:
            _store(surface, page, records[row] & 511, information[row], adding)
        first = last
    return first


@njit(cache=True, nogil=True)
def close_gaps(surface: Any, target: Any) -> None:
    """Copy all pages to `target`, which has none and room for all, side by side."""
    target.page[: len(surface.page)] = surface.page
    target.counts[PAGE_COUNT] = surface.counts[PAGE_COUNT]
    for page in range(surface.counts[PAGE_COUNT]):
        target.masks[page, :] = surface.masks[page]
        target.starts[page, :] = 0
        codes, full = _size(surface.masks[page], CODES), _size(surface.masks[page], FULL)
        if codes > 0:
            start, to = surface.starts[page, CODES], _take_room(target, CODES, _chunks(codes))
            target.starts[page, CODES] = to
            target.words[to : to + codes] = surface.words[start : start + codes]
            target.tails[to : to + codes] = surface.tails[start : start + codes]
        if full > 0:
            start, to = surface.starts[page, FULL], _take_room(target, FULL, _chunks(full))
            target.starts[page, FULL] = to
            target.information[to : to + full] = surface.information[start : start + full]


@njit(cache=True, nogil=True)
def _page_of(surface: Any, sheet: int) -> Any:
    """Page of a sheet, made if need be."""
    page = np.int64(surface.page[sheet])
    if page >= 0:
        return page
    page = surface.counts[PAGE_COUNT]
    surface.counts[PAGE_COUNT] = page + 1
    surface.page[sheet] = page
    surface.masks[page, :] = _ZERO
    surface.starts[page, :] = 0
    return page


@njit(cache=True, nogil=True)
def _want(masks: Any, page: int, records: Any, information: Any, rows: Any, wanted: Any) -> None:
    """The bit sets that a page needs to hold the rows as well."""
    wanted[:] = masks[page]
    for row in rows:
        word, bit = (records[row] & 511) >> 6, _ONE << np.uint64(records[row] & 63)
        if information[row, 0] == 0.0 or is_isotropic(information[row]):
            if not wanted[8 + word] & bit:
                wanted[word] |= bit
        else:
            wanted[8 + word] |= bit
            wanted[word] &= ~bit


@njit(cache=True, nogil=True)
def _size(masks: Any, kind: int) -> Any:
    """Number of records of a kind in bit sets, shape (16,)."""
    total = np.int64(0)
    for word in range(8 * kind, 8 * kind + 8):
        total += count_ones(masks[word])
    return total


@njit(cache=True, nogil=True)
def _chunks(count: int) -> Any:
    """Chunks for so many records."""
    return (np.int64(count) + CHUNK - 1) // CHUNK


@njit(cache=True, nogil=True)
def _is_room(surface: Any, kind: int, old: int, new: int) -> bool:
    """Whether records of a page can go from `old` to `new` chunks."""
    if new == old or new == 0 or surface.free[kind, new] >= 0:
        return True
    room = len(surface.words) if kind == CODES else len(surface.information)
    return bool(surface.counts[CODE_COUNT + kind] + new * CHUNK <= room)


@njit(cache=True, nogil=True)
def _take_room(surface: Any, kind: int, chunks: int) -> Any:
    """First record of unused room for so many chunks."""
    start = surface.free[kind, chunks]
    if start < 0:
        start = surface.counts[CODE_COUNT + kind]
        surface.counts[CODE_COUNT + kind] = start + chunks * CHUNK
        return start
    surface.counts[CODE_GAPS + kind] -= chunks * CHUNK
    if kind == CODES:
        surface.free[kind, chunks] = np.int64(surface.words[start]) - 1
    else:
        surface.free[kind, chunks] = np.int64(surface.information[start, 0]) * CHUNK - CHUNK
    return start


@njit(cache=True, nogil=True)
def _release_room(surface: Any, kind: int, start: int, chunks: int) -> None:
    """Give room back; it names what was free before."""
    following = surface.free[kind, chunks]
    if kind == CODES:
        surface.words[start] = np.uint64(following + 1)
    else:  # whole chunks, which float32 tells exactly
        surface.information[start, 0] = (following + CHUNK) // CHUNK
    surface.free[kind, chunks] = start
    surface.counts[CODE_GAPS + kind] += chunks * CHUNK


@njit(cache=True, nogil=True)
def _arrange(surface: Any, page: int, wanted: Any, work: Any) -> bool:
    """Make the records of a page those of the bit sets `wanted`, new ones without information.

    Returns:
        False, with nothing changed, when there is no room.
    """
    masks, same = surface.masks[page], True
    for word in range(16):
        same &= masks[word] == wanted[word]
    if same:
        return True
    old_codes, old_full = _chunks(_size(masks, CODES)), _chunks(_size(masks, FULL))
    codes, full = _chunks(_size(wanted, CODES)), _chunks(_size(wanted, FULL))
    if not (_is_room(surface, CODES, old_codes, codes) and _is_room(surface, FULL, old_full, full)):
        return False
    _collect(surface, page, wanted, work)
    _move(surface, page, CODES, old_codes, codes)
    _move(surface, page, FULL, old_full, full)
    masks[:] = wanted
    start, count = np.int64(surface.starts[page, CODES]), _size(wanted, CODES)
    surface.words[start : start + count] = work[0][:count]
    surface.tails[start : start + count] = work[1][:count]
    start, count = np.int64(surface.starts[page, FULL]), _size(wanted, FULL)
    surface.information[start : start + count] = work[2][:count]
    return True


@njit(cache=True, nogil=True)
def _move(surface: Any, page: int, kind: int, old: int, new: int) -> None:
    """Exchange a page's room of `old` chunks for one of `new`."""
    if old == new:
        return
    if old > 0:
        _release_room(surface, kind, np.int64(surface.starts[page, kind]), old)
    if new > 0:
        surface.starts[page, kind] = _take_room(surface, kind, new)


@njit(cache=True, nogil=True)
def _collect(surface: Any, page: int, wanted: Any, work: Any) -> None:
    """Copy the records of a page to `work`, in the order and form that `wanted` says."""
    words, tails, information = work
    source, full_source = surface.starts[page, CODES], surface.starts[page, FULL]
    codes, full = 0, 0
    for word in range(8):
        had, had_full = surface.masks[page, word], surface.masks[page, 8 + word]
        want, want_full = wanted[word], wanted[8 + word]
        while (want | want_full) != _ZERO:
            if want_full & _ONE:
                information[full, :] = 0.0
                if had_full & _ONE:
                    information[full, :] = surface.information[full_source]
                elif had & _ONE:
                    decode_information(
                        surface.words[source], surface.tails[source], information[full]
                    )
                full += 1
            elif want & _ONE:
                words[codes], tails[codes] = _ZERO, 0
                if had & _ONE:
                    words[codes], tails[codes] = surface.words[source], surface.tails[source]
                codes += 1
            source += np.int64(had & _ONE)
            full_source += np.int64(had_full & _ONE)
            had, had_full, want = had >> _ONE, had_full >> _ONE, want >> _ONE
            want_full = want_full >> _ONE


@njit(cache=True, nogil=True)
def _store(surface: Any, page: int, local: int, information: Any, adding: bool) -> None:
    """Merge or put information where a voxel has its record."""
    rank = rank_of(surface.masks, page, CODES, local)
    if rank >= 0:
        _store_code(surface, surface.starts[page, CODES] + rank, information, adding)
        return
    row = surface.starts[page, FULL] + rank_of(surface.masks, page, FULL, local)
    stored = surface.information
    for i in range(INFORMATION_SIZE):
        stored[row, i] = stored[row, i] + information[i] if adding else information[i]
    if not adding:
        canonical(stored[row])


@njit(cache=True, nogil=True)
def _store_code(surface: Any, row: int, information: Any, adding: bool) -> None:
    weight, x, y, z = 0.0, 0.0, 0.0, 0.0
    if adding:
        weight, x, y, z = decode(surface.words[row], surface.tails[row])
    total = weight + np.float64(information[0])
    if total == 0.0:
        surface.words[row], surface.tails[row] = _ZERO, 0
        return
    share = 1.0 / total
    surface.words[row], surface.tails[row] = encode(
        total,
        (weight * x + information[6]) * share,
        (weight * y + information[7]) * share,
        (weight * z + information[8]) * share,
    )
