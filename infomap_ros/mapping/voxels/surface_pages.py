"""Pages of sheets with records; layout in `infomap_ros.mapping.voxels.surface`."""

from __future__ import annotations

from typing import Any

import numpy as np

from infomap_ros.geometry.kernel import kernel
from infomap_ros.mapping.voxels.surface import FULL_MASK, MASK_COUNT, PAGE_COUNT
from infomap_ros.mapping.voxels.surface_reading import CODES, FULL, copy
from infomap_ros.mapping.voxels.surface_rooms import chunks_for, records_in, take_room

_ZERO = np.uint64(0)


@kernel
def close_gaps(surface: Any, target: Any) -> None:
    """Copy all pages to `target`, which has none and room for all, side by side."""
    for sheet in range(len(surface.page)):
        target.page[sheet] = surface.page[sheet]
    for kind in (PAGE_COUNT, MASK_COUNT):
        target.counts[kind] = surface.counts[kind]
    for row in range(surface.counts[MASK_COUNT]):
        for word in range(8):
            target.full_masks[row, word] = surface.full_masks[row, word]
    for page in range(surface.counts[PAGE_COUNT]):
        for word in range(8):
            target.masks[page, word] = surface.masks[page, word]
        target.starts[page, CODES] = target.starts[page, FULL] = 0
        target.starts[page, FULL_MASK] = surface.starts[page, FULL_MASK]
        codes, full = records_in(surface, page, CODES), records_in(surface, page, FULL)
        if codes > 0:
            start, to = surface.starts[page, CODES], take_room(target, CODES, chunks_for(codes))
            target.starts[page, CODES] = to
            for i in range(codes):
                target.words[to + i] = surface.words[start + i]
                target.tails[to + i] = surface.tails[start + i]
        if full > 0:
            start, to = surface.starts[page, FULL], take_room(target, FULL, chunks_for(full))
            target.starts[page, FULL] = to
            for i in range(full):
                copy(surface.information[start + i], target.information[to + i])


@kernel
def page_of(surface: Any, sheet: int) -> Any:
    """Page of a sheet, made if need be."""
    page = np.int64(surface.page[sheet])
    if page >= 0:
        return page
    page = surface.counts[PAGE_COUNT]
    surface.counts[PAGE_COUNT] = page + 1
    surface.page[sheet] = page
    surface.masks[page, :] = _ZERO
    surface.starts[page, CODES] = surface.starts[page, FULL] = 0
    surface.starts[page, FULL_MASK] = -1
    return page


@kernel
def set_masks(surface: Any, page: int, wanted: Any) -> None:
    """Give a page its bit sets, that of full information where there is any."""
    has_full, starts = _ZERO, surface.starts
    for word in range(8):
        surface.masks[page, word] = wanted[CODES, word]
        has_full |= wanted[FULL, word]
    if starts[page, FULL_MASK] < 0 and has_full != _ZERO:
        starts[page, FULL_MASK] = surface.counts[MASK_COUNT]
        surface.counts[MASK_COUNT] += 1
    if starts[page, FULL_MASK] >= 0:
        for word in range(8):
            surface.full_masks[starts[page, FULL_MASK], word] = wanted[FULL, word]
