"""Compiled storing of Gaussians; layout in `infomap_ros.mapping.voxels.surface`."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from infomap_ros.geometry.kernel import kernel
from infomap_ros.mapping.voxels.keys import BLOCK_VOXELS
from infomap_ros.mapping.voxels.surface import FULL_MASK, INFORMATION_SIZE
from infomap_ros.mapping.voxels.surface_code import (
    decode,
    decode_information,
    encode,
    encode_information,
    is_isotropic,
)
from infomap_ros.mapping.voxels.surface_pages import page_of, set_masks
from infomap_ros.mapping.voxels.surface_reading import (
    CODES,
    FULL,
    copy,
    count_ones,
    mask_word,
    rank_of,
)
from infomap_ros.mapping.voxels.surface_rooms import (
    chunks_for,
    is_room,
    move_room,
    records_in,
)

_ONE, _ZERO = np.uint64(1), np.uint64(0)


class StoreWork(NamedTuple):
    """Memory to arrange the records of one sheet.

    Attributes:
        words: of codes, uint64, shape (512,).
        tails: of codes, uint16, shape (512,).
        information: full information, float32, shape (512, 9).
        wanted: the bit sets that its page is to have, of either kind, uint64, shape (2, 8).
    """

    words: NDArray[np.uint64]
    tails: NDArray[np.uint16]
    information: NDArray[np.float32]
    wanted: NDArray[np.uint64]


def empty_work() -> StoreWork:
    """Memory to arrange records."""
    return StoreWork(
        np.empty(BLOCK_VOXELS, np.uint64),
        np.empty(BLOCK_VOXELS, np.uint16),
        np.empty((BLOCK_VOXELS, INFORMATION_SIZE), np.float32),
        np.empty((2, 8), np.uint64),
    )


@kernel
def canonical(information: Any) -> None:
    """Round information, shape (9,), to what a map can hold."""
    if is_isotropic(information):
        word, tail = encode_information(information)
        decode_information(word, tail, information)


@kernel
def arrange_records(
    surface: Any, records: Any, information: Any, order: Any, first: int, work: Any
) -> int:
    """Make records, without information, where there are none of the right kind.

    Args:
        surface: a `SurfaceArrays` with a page to spare for every sheet.
        records: 512 * sheet + local index of each row, int64; each at most once.
        information: shape (n, 9), float32.
        order: the rows that are stored, those of one sheet side by side.
        first: place in `order` where to begin.
        work: a `StoreWork`.

    Returns:
        Place in `order` before which room for records ran out, or its length.
    """
    while first < len(order):
        sheet, last = records[order[first]] >> 9, first + 1
        while last < len(order) and records[order[last]] >> 9 == sheet:
            last += 1
        page = page_of(surface, sheet)
        _want(surface, page, records, information, order, first, last, work.wanted)
        if not _arrange(surface, page, work):
            return first
        first = last
    return first


@kernel
def store_rows(
    surface: Any,
    records: Any,
    information: Any,
    order: Any,
    first: int,
    last: int,
    adding: bool,
) -> None:
    """Merge information into arranged records, or put it there.

    Args:
        surface: see `arrange_records`, likewise records, information and order.
        records: see surface.
        information: see surface.
        order: see surface.
        first: first place in `order`.
        last: one past the last place.
        adding: whether to add to what is there, else to replace it.
    """
    pages, starts, stored = surface.page, surface.starts, surface.information
    masks, full_masks = surface.masks, surface.full_masks
    words, tails = surface.words, surface.tails
    for place in range(first, last):
        row = order[place]
        page, local = np.int64(pages[records[row] >> 9]), records[row] & 511
        rank = rank_of(masks, page, local)
        if rank >= 0:
            _store_code(words, tails, starts[page, CODES] + rank, information, row, adding)
            continue
        to = starts[page, FULL] + rank_of(full_masks, starts[page, FULL_MASK], local)
        for i in range(INFORMATION_SIZE):
            before = stored[to, i] if adding else np.float32(0.0)
            stored[to, i] = before + information[row, i]
        if not adding:
            canonical(stored[to])


@kernel
def _store_code(words: Any, tails: Any, to: int, information: Any, row: int, adding: bool) -> None:
    weight, x, y, z = 0.0, 0.0, 0.0, 0.0
    if adding:
        weight, x, y, z = decode(words[to], tails[to])
    total = weight + np.float64(information[row, 0])
    if total == 0.0:
        words[to], tails[to] = _ZERO, 0
        return
    share = 1.0 / total
    words[to], tails[to] = encode(
        total,
        (weight * x + information[row, 6]) * share,
        (weight * y + information[row, 7]) * share,
        (weight * z + information[row, 8]) * share,
    )


@kernel
def _want(
    surface: Any,
    page: int,
    records: Any,
    information: Any,
    order: Any,
    first: int,
    last: int,
    wanted: Any,
) -> None:
    """The bit sets that a page needs to hold rows `order[first:last]` as well."""
    for word in range(8):
        wanted[CODES, word] = mask_word(surface, page, CODES, word)
        wanted[FULL, word] = mask_word(surface, page, FULL, word)
    for place in range(first, last):
        row = order[place]
        local = records[row] & 511
        word, bit = local >> 6, _ONE << np.uint64(local & 63)
        if information[row, 0] == 0.0 or is_isotropic(information[row]):
            if not wanted[FULL, word] & bit:
                wanted[CODES, word] |= bit
        else:
            wanted[FULL, word] |= bit
            wanted[CODES, word] &= ~bit


@kernel
def _arrange(surface: Any, page: int, work: Any) -> bool:
    """Make the records of a page those of the wanted bit sets, new ones without information.

    Returns:
        False, with nothing changed, when there is no room.
    """
    wanted, same, codes, full = work.wanted, True, np.int64(0), np.int64(0)
    for word in range(8):
        same &= mask_word(surface, page, CODES, word) == wanted[CODES, word]
        same &= mask_word(surface, page, FULL, word) == wanted[FULL, word]
        codes += count_ones(wanted[CODES, word])
        full += count_ones(wanted[FULL, word])
    if same:
        return True
    old_codes = chunks_for(records_in(surface, page, CODES))
    old_full = chunks_for(records_in(surface, page, FULL))
    if not is_room(surface, CODES, old_codes, chunks_for(codes)):
        return False
    if not is_room(surface, FULL, old_full, chunks_for(full)):
        return False
    _collect(surface, page, wanted, work)
    move_room(surface, page, CODES, old_codes, chunks_for(codes))
    move_room(surface, page, FULL, old_full, chunks_for(full))
    set_masks(surface, page, wanted)
    start = np.int64(surface.starts[page, CODES])
    for i in range(codes):
        surface.words[start + i], surface.tails[start + i] = work.words[i], work.tails[i]
    start = np.int64(surface.starts[page, FULL])
    for i in range(full):
        copy(work.information[i], surface.information[start + i])
    return True


@kernel
def _collect(surface: Any, page: int, wanted: Any, work: Any) -> None:
    """Copy the records of a page to `work`, in the order and form that `wanted` says."""
    words, tails, information = work.words, work.tails, work.information
    source, full_source = surface.starts[page, CODES], surface.starts[page, FULL]
    codes, full = 0, 0
    for word in range(8):
        had, had_full = surface.masks[page, word], mask_word(surface, page, FULL, word)
        want, want_full = wanted[CODES, word], wanted[FULL, word]
        while (want | want_full) != _ZERO:
            if want_full & _ONE:
                information[full, :] = 0.0
                if had_full & _ONE:
                    copy(surface.information[full_source], information[full])
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
