"""The map's arrays, and writing a scan into them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from infomap_ros.errors import CapacityError
from infomap_ros.mapping.config import VoxelMapConfig
from infomap_ros.mapping.scans import update
from infomap_ros.mapping.scans.scan import ScanRows
from infomap_ros.mapping.scans.workers import Workers
from infomap_ros.mapping.voxels.block_kernels import find_block
from infomap_ros.mapping.voxels.blocks import (
    BLOCK_BYTES,
    BLOCK_COUNT,
    DIRTY_BYTES,
    PLANE_BYTES,
    BlockArrays,
    block_bytes,
    empty_blocks,
    grown,
    with_room,
)
from infomap_ros.mapping.voxels.keys import BLOCK_VOXELS
from infomap_ros.mapping.voxels.records import growth_of_surface, with_arranged
from infomap_ros.mapping.voxels.surface import (
    SIDES,
    SurfaceArrays,
    empty_surface,
    growth_bound,
    surface_bytes,
)
from infomap_ros.mapping.voxels.surface_storing import store_rows

_RECORD_BITS = (SIDES * BLOCK_VOXELS).bit_length() - 1
"""Bits of a record's number below that of its block."""


@dataclass(frozen=True, eq=False)
class FreeBlocks:
    """Blocks with voxels that a scan sees through.

    Attributes:
        coordinates: block coordinates, shape (n, 3), int32.
        bits: one bit per free voxel, shape (n, 8), uint64.
    """

    coordinates: NDArray[np.int32]
    bits: NDArray[np.uint64]


@dataclass(frozen=True, eq=False)
class Observations:
    """What a scan says of the voxels in which it saw surfaces.

    Attributes:
        parts: the voxels.
        ends: where the rows of each part begin in what follows, and at the end how many there are.
        information: information matrix and vector of each row, shape (n, 9), float32; the first
            entry is 0 where there is none.
        hits: occupancy evidence of each row, shape (n,), int32 [quanta].
        sides: from which the surface is seen, shape (n,), uint8.
    """

    parts: list[ScanRows]
    ends: list[int]
    information: NDArray[np.float32]
    hits: NDArray[np.int32]
    sides: NDArray[np.uint8]

    def rows(self) -> Iterator[tuple[ScanRows, slice]]:
        """Each part, and which rows are its."""
        return zip(self.parts, map(slice, self.ends[:-1], self.ends[1:]), strict=True)


@dataclass
class MapStorage:
    """The map's arrays; replaced by larger ones as the map grows.

    Attributes:
        blocks: occupancy.
        gaussians: surface points.
        gone: bit set of the voxels that were known once and are not, if they were not observed
            since, uint64, shape (n, 8) for the first n blocks.
    """

    blocks: BlockArrays = field(default_factory=empty_blocks)
    gaussians: SurfaceArrays = field(default_factory=empty_surface)
    gone: NDArray[np.uint64] = field(default_factory=lambda: np.zeros((0, 8), np.uint64))

    def memory_bytes(self) -> int:
        """Memory in use [bytes]."""
        surface = surface_bytes(self.gaussians, int(self.blocks.counts[BLOCK_COUNT]))
        return block_bytes(self.blocks) + surface + self.gone.nbytes

    def check_capacity(self, observed: Observations, free: FreeBlocks, limit: float) -> None:
        """Refuse a scan that could make the map larger than `limit` [bytes].

        Raises:
            CapacityError: it could.
        """
        rows, used = len(observed.hits), self.memory_bytes()
        surface = growth_bound(self.gaussians, rows, rows)
        growth = surface + growth_bytes(self, rows + len(free.bits), rows + len(free.bits))
        if used + growth > limit:  # the scan alone does not tell; ask the map
            counts = np.zeros(2, np.int64)
            for part, own in observed.rows():
                update.count_new_by_rows(self.blocks, part, observed.hits[own], counts)
            update.count_new_by_free(self.blocks, free.coordinates, free.bits, counts)
            surface = _surface_growth(self, observed)
            growth = surface + growth_bytes(self, int(counts[0]), int(counts[1]))
        if used + growth > limit:
            raise CapacityError(
                f"the map holds {used / 1e9:.3g} GB and this scan could bring it to "
                f"{(used + growth) / 1e9:.3g} GB, above the limit of {limit / 1e9:g} GB"
            )


def growth_bytes(storage: MapStorage, blocks: int, planes: int) -> int:
    """What so many new blocks and planes add to the memory in use, at the most; no Gaussians."""
    table = storage.blocks.table
    block_count = int(storage.blocks.counts[BLOCK_COUNT]) + blocks
    table_growth = 4 * max(2 * block_count, 2 * len(table)) if 2 * block_count > len(table) else 0
    per_block = BLOCK_BYTES + 4 + (DIRTY_BYTES if len(storage.blocks.dirty) else 0)
    return blocks * per_block + planes * PLANE_BYTES + table_growth


def _surface_growth(storage: MapStorage, observed: Observations) -> int:
    """What observations add to the memory of the Gaussians, at the most [bytes]."""
    blocks = np.empty(len(observed.hits), np.int64)
    for part, own in observed.rows():
        update.block_keys(part, blocks[own])
    keys, places = np.unique(blocks, return_inverse=True)
    slots = np.array([find_block(storage.blocks, key) for key in keys], np.int64)
    sheets = (SIDES * slots[:, None] + np.arange(SIDES)).ravel()
    places = SIDES * places + observed.sides
    return growth_of_surface(storage.gaussians, sheets, places, observed.information)


class ScanWriter:
    """Writes scans into a `MapStorage`; keeps the scratch memory for it."""

    def __init__(self, config: VoxelMapConfig, workers: Workers) -> None:
        self._hit, self._miss = config.hit_quanta, config.miss_quanta
        self._workers = workers
        self._hit_row = np.full(0, -1, np.int32)

    def write(self, storage: MapStorage, observed: Observations, free: FreeBlocks) -> None:
        """Add the observations of a scan and the misses of the voxels it sees through."""
        count, free_count = len(observed.hits), len(free.bits)
        blocks = with_room(storage.blocks, count + free_count, count + free_count)
        storage.blocks = blocks
        self._hit_row = grown(self._hit_row, len(blocks.keys), -1)
        hit_bits = np.empty((count, 8), np.uint64)
        records = self._enter(blocks, observed, hit_bits)
        information, entered = observed.information, int(blocks.counts[BLOCK_COUNT])
        orders: list[NDArray[np.int64]] = []

        def arrange() -> None:
            update.mark_merged(blocks.dirty, records, information)
            storage.gaussians, order = with_arranged(
                storage.gaussians, entered, records, information, adding=True
            )
            orders.append(order)

        def see_through() -> None:
            update.free_voxels(
                blocks, free.coordinates, free.bits, free_count, self._hit_row, hit_bits, self._miss
            )
            self._hit_row[records >> _RECORD_BITS] = -1

        if len(blocks.dirty):  # both write which voxels changed
            arrange()
            see_through()
        else:
            self._workers.together(arrange, see_through)

        def store(first: int, last: int) -> None:
            store_rows(storage.gaussians, records, information, orders[0], first, last, True)

        self._workers.share((store, len(orders[0])))

    def _enter(
        self, blocks: BlockArrays, observed: Observations, hit_bits: NDArray[np.uint64]
    ) -> NDArray[np.int64]:
        """Add the hits; returns the record of each row."""
        records, hit_blocks = np.empty(len(observed.hits), np.int64), 0
        for part, own in observed.rows():
            hit_blocks = update.enter_rows(
                blocks,
                part,
                observed.hits[own],
                observed.information[own],
                observed.sides[own],
                hit_blocks,
                self._hit_row,
                hit_bits,
                records[own],
                -self._miss,
                self._hit,
            )
        return records
