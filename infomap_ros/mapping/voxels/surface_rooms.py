"""Room for the records of a sheet; layout in `infomap_ros.mapping.voxels.surface`."""

from __future__ import annotations

from typing import Any

import numpy as np

from infomap_ros.geometry.kernel import kernel
from infomap_ros.mapping.voxels.surface import CHUNK, CODE_COUNT, CODE_GAPS
from infomap_ros.mapping.voxels.surface_reading import CODES, count_ones, mask_word


@kernel
def records_in(surface: Any, page: int, kind: int) -> Any:
    """Number of records of a kind of a page."""
    total = np.int64(0)
    for word in range(8):
        total += count_ones(mask_word(surface, page, kind, word))
    return total


@kernel
def chunks_for(count: int) -> Any:
    """Chunks for so many records."""
    return (np.int64(count) + CHUNK - 1) // CHUNK


@kernel
def is_room(surface: Any, kind: int, old: int, new: int) -> bool:
    """Whether records of a page can go from `old` to `new` chunks."""
    if new == old or new == 0 or surface.free[kind, new] >= 0:
        return True
    room = len(surface.words) if kind == CODES else len(surface.information)
    return bool(surface.counts[CODE_COUNT + kind] + new * CHUNK <= room)


@kernel
def take_room(surface: Any, kind: int, chunks: int) -> Any:
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


@kernel
def _release_room(surface: Any, kind: int, start: int, chunks: int) -> None:
    """Give room back; it names what was free before."""
    following = surface.free[kind, chunks]
    if kind == CODES:
        surface.words[start] = np.uint64(following + 1)
    else:  # whole chunks, which float32 tells exactly
        surface.information[start, 0] = (following + CHUNK) // CHUNK
    surface.free[kind, chunks] = start
    surface.counts[CODE_GAPS + kind] += chunks * CHUNK


@kernel
def move_room(surface: Any, page: int, kind: int, old: int, new: int) -> None:
    """Exchange a page's room of `old` chunks for one of `new`."""
    if old == new:
        return
    if old > 0:
        _release_room(surface, kind, np.int64(surface.starts[page, kind]), old)
    if new > 0:
        surface.starts[page, kind] = take_room(surface, kind, new)
