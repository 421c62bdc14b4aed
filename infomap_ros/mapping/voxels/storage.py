"""The map's arrays, and writing a scan into them."""

from __future__ import annotations

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
    """What a part of a scan says of the voxels in which it saw surfaces.

    Attributes:
        rows: the voxels.
        information: information matrix and vector of each row, shape (n, 9), float32; the first
            entry is 0 where there is none.
        hits: occupancy evidence of each row, shape (n,), int32 [quanta].
        sides: from which the surface is seen, shape (n,), uint8.
    """

    rows: ScanRows
    information: NDArray[np.float32]
    hits: NDArray[np.int32]
    sides: NDArray[np.uint8]


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

    def check_capacity(self, parts: list[Observations], free: FreeBlocks, limit: float) -> None:
        """Refuse a scan that could make the map larger than `limit` [bytes].

        Raises:
            CapacityError: it could.
        """
        rows, used = sum(len(part.hits) for part in parts), self.memory_bytes()
        surface = growth_bound(self.gaussians, rows, rows)
        growth = surface + growth_bytes(self, rows + len(free.bits), rows + len(free.bits))
        if used + growth > limit:  # the scan alone does not tell; ask the map
            counts = np.zeros(2, np.int64)
            for part in parts:
                update.count_new_by_rows(self.blocks, part.rows, part.hits, counts)
            update.count_new_by_free(self.blocks, free.coordinates, free.bits, counts)
            surface = sum(_surface_growth(self, part) for part in parts)
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


def _surface_growth(storage: MapStorage, part: Observations) -> int:
    """What the observations of a part add to the memory of the Gaussians, at the most [bytes]."""
    blocks = np.empty(len(part.hits), np.int64)
    update.block_keys(part.rows, blocks)
    keys, places = np.unique(blocks, return_inverse=True)
    slots = np.array([find_block(storage.blocks, key) for key in keys], np.int64)
    sheets = (SIDES * slots[:, None] + np.arange(SIDES)).ravel()
    places = SIDES * places + part.sides
    return growth_of_surface(storage.gaussians, sheets, places, part.information)


class ScanWriter:
    """Writes scans into a `MapStorage`; keeps the scratch memory for it."""

    def __init__(self, config: VoxelMapConfig, workers: Workers) -> None:
        self._hit, self._miss = config.hit_quanta, config.miss_quanta
        self._workers = workers
        self._hit_row = np.full(0, -1, np.int32)

    def write(self, storage: MapStorage, parts: list[Observations], free: FreeBlocks) -> None:
        """Add the observations of a scan and the misses of the voxels it sees through."""
        count, free_count = sum(len(part.hits) for part in parts), len(free.bits)
        blocks = with_room(storage.blocks, count + free_count, count + free_count)
        storage.blocks = blocks
        self._hit_row = grown(self._hit_row, len(blocks.keys), -1)
        hit_bits = np.zeros((count, 8), np.uint64)
        owners = self._enter(blocks, parts, hit_bits)

        orders: list[NDArray[np.int64]] = []

        def arrange() -> None:
            for part, voxels in zip(parts, owners, strict=True):
                update.mark_merged(blocks.dirty, voxels, part.information)
                storage.gaussians, order = with_arranged(
                    storage.gaussians, len(blocks.keys), voxels, part.information, adding=True
                )
                orders.append(order)

        def see_through() -> None:
            update.free_voxels(
                blocks, free.coordinates, free.bits, free_count, self._hit_row, hit_bits, self._miss
            )

        if len(blocks.dirty):  # both write which voxels changed
            arrange()
            see_through()
        else:
            self._workers.together(arrange, see_through)
        for part, voxels, order in zip(parts, owners, orders, strict=True):
            self._merge(storage.gaussians, voxels, part.information, order)
        for voxels in owners:
            self._hit_row[voxels // (SIDES * BLOCK_VOXELS)] = -1

    def _merge(
        self,
        gaussians: SurfaceArrays,
        records: NDArray[np.int64],
        information: NDArray[np.float32],
        order: NDArray[np.int64],
    ) -> None:
        """Add information to arranged records."""

        def store(_: int, first: int, last: int) -> None:
            store_rows(gaussians, records, information, order, first, last, True)

        self._workers.run(store, len(order))

    def _enter(
        self, blocks: BlockArrays, parts: list[Observations], hit_bits: NDArray[np.uint64]
    ) -> list[NDArray[np.int64]]:
        """Add the hits; returns the record of each row."""
        owners, hit_blocks = [], 0
        for part in parts:
            voxels = np.empty(len(part.hits), np.int64)
            hit_blocks = update.enter_rows(
                blocks,
                part.rows,
                part.hits,
                part.information,
                part.sides,
                hit_blocks,
                self._hit_row,
                hit_bits,
                voxels,
                -self._miss,
                self._hit,
            )
            owners.append(voxels)
        return owners
