"""One Gaussian per voxel in which a surface may lie, in information form.

The information is a matrix (xx, xy, xz, yy, yz, zz) [1/m^2] and a vector [1/m] of the surface point
relative to the voxel's centre. Merging two estimates is a sum (eq. 4 of Sujan and Dubowsky 2005,
https://doi.org/10.1177/0278364905051774, in its symmetric form ``C = (C1^-1 + C2^-1)^-1``), so the
order of measurements does not matter.

What is seen from one side of a thin wall must not be merged with what is seen from the other. A
block therefore has two sheets, number ``2 * slot + side``, and a voxel up to two records, number
``512 * sheet + local index``; `side_of` a normal tells which. How they become one estimate is told
in `surface_reading`.

A sheet with records has a page: a bit set that tells which of its voxels are stored, and where.
The records of a sheet stand side by side in the order of its voxels, so that a voxel's is found by
counting bits. Isotropic ones take the ten bytes of `surface_code`. Others take nine float32; a page
with such, which is rare where voxels are small, has a second bit set for them.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from infomap_ros.errors import CapacityError
from infomap_ros.geometry.kernel import kernel
from infomap_ros.mapping.voxels.blocks import grown
from infomap_ros.mapping.voxels.keys import BLOCK_VOXELS
from infomap_ros.mapping.voxels.surface_code import CODE_BYTES

INFORMATION_SIZE = 9
FULL_BYTES = 4 * INFORMATION_SIZE
CHUNK = 8
"""A sheet's records have room for a multiple of this."""

SIDES = 2
_ACROSS = (0.262, 0.472, 0.841)

PAGE_BYTES, MASK_BYTES = 8 * 8 + 3 * 4, 8 * 8
MOST_CHUNKS = BLOCK_VOXELS // CHUNK
PAGE_COUNT, CODE_COUNT, FULL_COUNT, CODE_GAPS, FULL_GAPS, MASK_COUNT = range(6)
"""Places in `SurfaceArrays.counts`."""

FULL_MASK = 2
"""Column of `SurfaceArrays.starts`; before it are those of either kind of records."""

_MAX_BLOCKS, _MAX_RECORDS = 2**32 // BLOCK_VOXELS, 2**27


@kernel
def side_of(x: float, y: float, z: float) -> int:
    """Side, 0 or 1, from which a surface with normal (x, y, z), of any length, is seen.

    Opposite normals have different sides. The plane between them is far from those of the axes,
    so that noise seldom splits what is seen of one wall or floor.
    """
    return 1 if _ACROSS[0] * x + _ACROSS[1] * y + _ACROSS[2] * z < 0.0 else 0


class SurfaceArrays(NamedTuple):
    """The arrays of the Gaussians, as the kernels take them.

    Attributes:
        page: of each sheet, or -1, int32.
        masks: bit set of each page, uint64, shape (n, 8): the voxels with a code.
        full_masks: bit sets of the voxels with full information, uint64, shape (m, 8).
        starts: first record of each page, int32, shape (n, 3): code, full information; and its row
            of `full_masks` or -1.
        words: of the codes, uint64.
        tails: of the codes, uint16.
        information: full information, shape (n, 9), float32.
        free: first unused room of so many chunks, or -1, int64, shape (2, 65); it names the next.
        counts: pages, codes and rows of full information in use, how many of the latter two are
            gaps between blocks, and rows of `full_masks` in use, int64.
    """

    page: NDArray[np.int32]
    masks: NDArray[np.uint64]
    full_masks: NDArray[np.uint64]
    starts: NDArray[np.int32]
    words: NDArray[np.uint64]
    tails: NDArray[np.uint16]
    information: NDArray[np.float32]
    free: NDArray[np.int64]
    counts: NDArray[np.int64]


def empty_surface() -> SurfaceArrays:
    """Arrays of a map without surface."""
    return SurfaceArrays(
        page=np.full(512, -1, np.int32),
        masks=np.empty((64, 8), np.uint64),
        full_masks=np.empty((64, 8), np.uint64),
        starts=np.empty((64, 3), np.int32),
        words=np.empty(1024, np.uint64),
        tails=np.empty(1024, np.uint16),
        information=np.empty((1024, INFORMATION_SIZE), np.float32),
        free=np.full((2, MOST_CHUNKS + 1), -1, np.int64),
        counts=np.zeros(6, np.int64),
    )


def with_pages(arrays: SurfaceArrays, blocks: int, pages: int) -> SurfaceArrays:
    """Arrays for a map of so many blocks, with room for so many pages that are new or new in full.

    Raises:
        CapacityError: the map has more blocks than a voxel's number can tell.
    """
    if blocks > _MAX_BLOCKS:
        raise CapacityError(f"the map would need {blocks} blocks, the limit is {_MAX_BLOCKS}")
    used, full = int(arrays.counts[PAGE_COUNT]), int(arrays.counts[MASK_COUNT])
    return arrays._replace(
        page=grown(arrays.page, SIDES * blocks, -1),
        masks=grown(arrays.masks, used + pages, used=used),
        full_masks=grown(arrays.full_masks, full + pages, used=full),
        starts=grown(arrays.starts, used + pages, used=used),
    )


def with_records(arrays: SurfaceArrays, more: int) -> SurfaceArrays:
    """Arrays with room for so many more records of either kind, behind those in use.

    Raises:
        CapacityError: there are more records than can be numbered.
    """
    codes, full = int(arrays.counts[CODE_COUNT]), int(arrays.counts[FULL_COUNT])
    if max(codes, full) + more > _MAX_RECORDS:
        raise CapacityError(f"the map would need more than {_MAX_RECORDS} Gaussians")
    return arrays._replace(
        words=grown(arrays.words, codes + more, used=codes),
        tails=grown(arrays.tails, codes + more, used=codes),
        information=grown(arrays.information, full + more, used=full),
    )


def surface_bytes(arrays: SurfaceArrays, blocks: int) -> int:
    """Memory in use by the Gaussians of a map of so many blocks [bytes]; unused room included."""
    counts = arrays.counts
    return int(
        4 * SIDES * blocks
        + counts[PAGE_COUNT] * PAGE_BYTES
        + counts[MASK_COUNT] * MASK_BYTES
        + counts[CODE_COUNT] * CODE_BYTES
        + counts[FULL_COUNT] * FULL_BYTES
        + arrays.free.nbytes
    )


def growth_bound(arrays: SurfaceArrays, rows: int, blocks: int) -> int:
    """What observations of so many voxels in so many blocks add to that, at the most [bytes]."""
    counts = arrays.counts
    moved = min(blocks * SIDES * BLOCK_VOXELS, int(counts[CODE_COUNT])) * CODE_BYTES
    moved += min(blocks * SIDES * BLOCK_VOXELS, int(counts[FULL_COUNT])) * FULL_BYTES
    per_block = SIDES * (PAGE_BYTES + MASK_BYTES + CHUNK * (CODE_BYTES + FULL_BYTES))
    return moved + rows * FULL_BYTES + blocks * per_block
