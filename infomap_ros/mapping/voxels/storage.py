"""The map's arrays, and writing a scan into them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from infomap_ros.errors import CapacityError
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.mapping.config import VoxelMapConfig
from infomap_ros.mapping.scans import update
from infomap_ros.mapping.scans.scan import ScanRows
from infomap_ros.mapping.scans.workers import Workers
from infomap_ros.mapping.voxels import surface
from infomap_ros.mapping.voxels.block_kernels import find_block
from infomap_ros.mapping.voxels.keys import (
    BLOCK_BYTES,
    BLOCK_COUNT,
    BLOCK_VOXELS,
    DIRTY_BYTES,
    PLANE_BYTES,
    BlockArrays,
    block_bytes,
    empty_blocks,
    grown,
    with_room,
)
from infomap_ros.mapping.voxels.surface import (
    SurfaceArrays,
    WitnessArrays,
    Witnesses,
    empty_surface,
    surface_bytes,
)
from infomap_ros.mapping.voxels.surface_kernels import (
    INFORMATION_SIZE,
    ROW_COUNT,
    SIDES,
    add_observations,
)

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
        shares: how much of its variance other scans have too, b and a of `voxels.surface`, shape
            (n, 2), float32 [1/m].
        clock: of the drift.
    """

    parts: list[ScanRows]
    ends: list[int]
    information: NDArray[np.float32]
    hits: NDArray[np.int32]
    sides: NDArray[np.uint8]
    shares: NDArray[np.float32]
    clock: float

    def rows(self) -> Iterator[tuple[ScanRows, slice]]:
        """Each part, and which rows are its."""
        return zip(self.parts, map(slice, self.ends[:-1], self.ends[1:]), strict=True)


def empty_observations(parts: list[ScanRows], ends: list[int], clock: float) -> Observations:
    """Room for what a scan says of some voxels."""
    count = ends[-1]
    return Observations(
        parts,
        ends,
        np.empty((count, INFORMATION_SIZE), np.float32),
        np.empty(count, np.int32),
        np.zeros(count, np.uint8),
        np.zeros((count, 2), np.float32),
        float(np.float32(clock)),
    )


class Growth(NamedTuple):
    """What a map may grow by, at the most."""

    blocks: int
    planes: int
    pages: int
    rows: int


@dataclass
class MapStorage:
    """The map's arrays; replaced by larger ones as the map grows.

    Attributes:
        blocks: occupancy.
        gaussians: surface points.
        gone: bit set of the voxels that were known once and are not, if they were not observed
            since, uint64, shape (n, 8) for the first n blocks.
        offset: covariance of the error that the whole map shares, at its origin, shape (6, 6).
        taken_offset: likewise, when all surface points last counted as changed because of it.
    """

    blocks: BlockArrays = field(default_factory=empty_blocks)
    gaussians: SurfaceArrays = field(default_factory=empty_surface)
    gone: NDArray[np.uint64] = field(default_factory=lambda: np.zeros((0, 8), np.uint64))
    offset: FloatArray = field(default_factory=lambda: np.zeros((6, 6)))
    taken_offset: FloatArray = field(default_factory=lambda: np.zeros((6, 6)))

    def memory_bytes(self) -> int:
        """Memory in use [bytes]."""
        gaussians = surface_bytes(self.gaussians, int(self.blocks.counts[BLOCK_COUNT]))
        return block_bytes(self.blocks) + gaussians + self.gone.nbytes

    def check_capacity(self, observed: Observations, free: FreeBlocks, limit: float) -> None:
        """Refuse a scan that could make the map larger than `limit` [bytes], or than its numbers.

        Raises:
            CapacityError: it could.
        """
        rows = len(observed.hits)
        growth = Growth(rows + len(free.bits), rows + len(free.bits), rows, rows)
        try:
            self.check_growth(growth, limit)
        except CapacityError:  # the scan alone does not tell; ask the map
            self.check_growth(_growth(self, observed, free), limit)

    def check_growth(self, growth: Growth, limit: float = np.inf) -> None:
        """Refuse to grow above `limit` [bytes], or above what can be numbered.

        Raises:
            CapacityError: it would.
        """
        blocks = int(self.blocks.counts[BLOCK_COUNT]) + growth.blocks
        rows = int(self.gaussians.counts[ROW_COUNT]) + growth.rows
        if blocks > surface.MAX_BLOCKS or rows > surface.MAX_ROWS:
            raise CapacityError(
                f"the map could need {blocks} blocks and {rows} Gaussians, the limits are "
                f"{surface.MAX_BLOCKS} and {surface.MAX_ROWS}"
            )
        used, more = self.memory_bytes(), growth_bytes(self, growth)
        if used + more > limit:
            raise CapacityError(
                f"the map holds {used / 1e9:.3g} GB and this could bring it to "
                f"{(used + more) / 1e9:.3g} GB, above the limit of {limit / 1e9:g} GB"
            )


def growth_bytes(storage: MapStorage, growth: Growth) -> int:
    """What growing adds to the memory in use, at the most [bytes]."""
    table = storage.blocks.table
    count = int(storage.blocks.counts[BLOCK_COUNT]) + growth.blocks
    table_growth = 4 * max(2 * count, 2 * len(table)) if 2 * count > len(table) else 0
    per_block = BLOCK_BYTES + 4 * SIDES + (DIRTY_BYTES if len(storage.blocks.dirty) else 0)
    occupancy = growth.blocks * per_block + growth.planes * PLANE_BYTES + table_growth
    return occupancy + growth.pages * surface.PAGE_BYTES + growth.rows * surface.ROW_BYTES


def _growth(storage: MapStorage, observed: Observations, free: FreeBlocks) -> Growth:
    """What a scan adds to a map, nearly."""
    counts, keys = np.zeros(2, np.int64), np.empty(len(observed.hits), np.int64)
    locals_ = np.empty(len(observed.hits), np.int64)
    for part, own in observed.rows():
        update.count_new_by_rows(storage.blocks, part, observed.hits[own], counts)
        update.block_keys(part, keys[own], locals_[own])
    update.count_new_by_free(storage.blocks, free.coordinates, free.bits, counts)
    found, places = np.unique(keys, return_inverse=True)
    slots = np.array([find_block(storage.blocks, key) for key in found], np.int64)
    slots = np.where(slots < 0, -1 - np.arange(len(slots)), slots)
    seen = observed.information[:, 0] > 0.0
    sheets = SIDES * slots[places[seen]] + observed.sides[seen]
    pages, rows = surface.count_new(storage.gaussians, sheets, locals_[seen])
    return Growth(int(counts[0]), int(counts[1]), pages, rows)


class ScanWriter:
    """Writes scans into a `MapStorage`; keeps the scratch memory for it."""

    def __init__(self, config: VoxelMapConfig, workers: Workers) -> None:
        self._hit, self._miss = config.hit_quanta, config.miss_quanta
        self._workers = workers
        self._hit_row = np.full(0, -1, np.int32)
        self._witnesses = Witnesses()

    def write(
        self, storage: MapStorage, observed: Observations, free: FreeBlocks, pose: FloatArray
    ) -> None:
        """Add the observations of a scan and the misses of the voxels it sees through.

        Args:
            storage: the map.
            observed: the observations.
            free: the voxels that it sees through.
            pose: T_map_sensor, shape (4, 4): scans from one place are not independent witnesses.
        """
        count = len(observed.hits) + len(free.bits)
        storage.blocks = with_room(storage.blocks, count, count)
        self._hit_row = grown(self._hit_row, len(storage.blocks.keys), -1)
        records = np.zeros(len(observed.hits), np.int64)
        try:
            witnesses = self._witnesses.at(pose, len(storage.blocks.keys), count)
            self._write(storage, observed, free, records, witnesses)
        finally:
            self._hit_row[records >> _RECORD_BITS] = -1

    def _write(
        self,
        storage: MapStorage,
        observed: Observations,
        free: FreeBlocks,
        records: NDArray[np.int64],
        witnesses: WitnessArrays,
    ) -> None:
        blocks, information = storage.blocks, observed.information
        hit_bits = np.empty((len(records), 8), np.uint64)
        self._enter(blocks, observed, hit_bits, records, witnesses)
        order, entered = np.flatnonzero(information[:, 0]), int(blocks.counts[BLOCK_COUNT])
        rows: list[NDArray[np.int64]] = []

        def open_rows() -> None:
            update.mark_merged(blocks.dirty, records, information)
            arrays, found = surface.with_records(storage.gaussians, entered, records[order])
            storage.gaussians = arrays
            rows.append(found)

        def see_through() -> None:
            hits = self._hit_row, hit_bits
            update.free_voxels(blocks, free.coordinates, free.bits, *hits, witnesses, self._miss)

        if len(blocks.dirty):  # both write which voxels changed
            open_rows()
            see_through()
        else:
            self._workers.together(open_rows, see_through)

        def add(first: int, last: int) -> None:
            given = order, information, observed.shares, observed.clock
            add_observations(storage.gaussians.rows, rows[0], *given, first, last)

        self._workers.share((add, len(order)))

    def _enter(
        self,
        blocks: BlockArrays,
        observed: Observations,
        hit_bits: NDArray[np.uint64],
        records: NDArray[np.int64],
        witnesses: WitnessArrays,
    ) -> None:
        """Add the hits, and note the record of each row."""
        hit_blocks = 0
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
                witnesses,
                -self._miss,
                self._hit,
            )
