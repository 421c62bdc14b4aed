"""What one robot reported of its part of the map, as every replica keeps it.

States are kept in the codes of the wire, so that hashes of what was received are the same on every
machine and states can be passed on unchanged. A hash is a sum over voxels: the order in which
they were received does not matter, and which parts differ is found by comparing hashes of parts.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from infomap_ros.mapping import NOT_OBSERVED
from infomap_ros.mapping.voxels.keys import (
    BLOCK_BITS,
    BLOCK_COUNT,
    BLOCK_SIDE,
    BLOCK_VOXELS,
    BlockArrays,
    empty_blocks,
    grown,
    pack_all,
)
from infomap_ros.mapping.voxels.keys import BLOCK_BYTES as KEY_BYTES
from infomap_ros.mapping.voxels.keys import with_room as with_block_room
from infomap_ros.mapping.voxels.state import count_block_changes
from infomap_ros.team import contribution_kernels as kernels
from infomap_ros.team.gaussian_code import (
    CodeTable,
    code_tables,
    empty_codes,
    with_code_room,
    with_table_room,
)
from infomap_ros.team.update import MapUpdate, is_newer

BLOCK_BYTES = 5 * BLOCK_VOXELS + 12
"""Memory of a block's states and versions [bytes]."""

CODE_BYTES = 20
"""Memory of a surface point's code [bytes]."""

_FIRST_BLOCKS = 8  # for which there is room at first: a robot with one voxel costs 30 kB
_KEPT_AT_ONCE = 4096  # blocks that are copied in one go
Corners = NDArray[np.int32]


class Planes(NamedTuple):
    """What is kept of each block.

    Attributes:
        log_odds: `NOT_OBSERVED` where nothing is known, shape (n, 512), int8.
        versions: of each voxel's state, 0 where nothing was sent, shape (n, 512), uint32.
        newest: version of the block, uint32.
        hashes: sum of the hashes of the block's states, uint64.
    """

    log_odds: NDArray[np.int8]
    versions: NDArray[np.uint32]
    newest: NDArray[np.uint32]
    hashes: NDArray[np.uint64]


class Cells(NamedTuple):
    """Hashes of the parts of a contribution.

    Attributes:
        level: the parts are cubes of 2^level blocks.
        corners: their coordinates in units of their edge, shape (n, 3), int32.
        hashes: of what is known in them, shape (n,), uint32; 0 where nothing is.
    """

    level: int
    corners: NDArray[np.int32]
    hashes: NDArray[np.uint32]


class Contribution:
    """The newest state of every voxel that a robot sent.

    Args:
        voxel_size: edge of a voxel [m].
        origin: names the frame in which all of it is, as in `MapUpdate`.

    Attributes:
        newest: the newest version of all states, 0 before the first.
        is_cut: whether blocks were dropped for want of memory: then it is no longer what the robot
            sent, and not compared with what others hold of it.
    """

    def __init__(self, voxel_size: float, origin: int = 0) -> None:
        self._size, self.origin = voxel_size, origin
        self._blocks: BlockArrays = _few_blocks()
        self._codes = empty_codes()
        self._planes = Planes(
            np.full((0, BLOCK_VOXELS), NOT_OBSERVED, np.int8),
            np.zeros((0, BLOCK_VOXELS), np.uint32),
            np.zeros(0, np.uint32),
            np.zeros(0, np.uint64),
        )
        self.newest, self.is_cut = 0, False

    @property
    def arrays(self) -> tuple[BlockArrays, Planes, CodeTable]:
        """The arrays, for kernels that read them."""
        return self._blocks, self._planes, self._codes

    @property
    def blocks(self) -> int:
        """Number of blocks."""
        return int(self._blocks.counts[BLOCK_COUNT])

    def memory_bytes(self) -> int:
        """Memory of all arrays, used or not [bytes]."""
        return sum(array.nbytes for part in self.arrays for array in part)

    def count_new(self, indices: NDArray[np.int32]) -> int:
        """Number of blocks of voxels, shape (K, 3), of which nothing was sent; at the most."""
        corners = np.empty((int(count_block_changes(indices)), 3), np.int32)
        kernels.list_blocks(indices, corners)
        slots = np.full(len(corners), -1, np.int64)
        kernels.find_blocks(self._blocks, corners, slots)
        return int(np.count_nonzero(slots < 0))

    def count_new_surfaces(self, update: MapUpdate) -> int:
        """Number of surface points of an update of whose voxels no surface was sent."""
        states = update.indices, update.codes
        return int(kernels.count_new_codes(self._blocks, self._codes, *states))

    def growth_bytes(self, blocks: int, surfaces: int) -> int:
        """What memory is added for so many more blocks and surface points, at the most [bytes]."""
        room, rows = len(self._blocks.keys), len(self._codes.codes)
        slots = _grown_to(room, self.blocks + blocks) - room
        table = len(self._blocks.table)
        table = _grown_to(table, 2 * (self.blocks + blocks), 1.0) - table
        codes = _grown_to(rows, int(self._codes.counts[0]) + surfaces) - rows
        return slots * (KEY_BYTES + 4 + BLOCK_BYTES) + 4 * table + (CODE_BYTES + 8) * codes

    def accept(self, update: MapUpdate) -> NDArray[np.bool_]:
        """Keep the states that are newer than what was received.

        Returns:
            Which states are other than before, shape (K,).
        """
        room, surfaces = self.count_new(update.indices), self.count_new_surfaces(update)
        self._blocks = with_block_room(self._blocks, room, 0)
        self._planes = _grown_planes(self._planes, len(self._blocks.keys))
        self._codes = with_code_room(self._codes, surfaces, len(self._blocks.keys))
        count, done = len(update.versions), 0
        changed = np.zeros(count, np.bool_)
        states = update.indices, update.versions, update.log_odds, update.codes
        while done < count:
            self._codes = with_table_room(self._codes)
            done = kernels.accept_states(
                self._blocks, self._planes, self._codes, *states, done, changed
            )
        for version in np.unique(update.versions):
            if is_newer(version, np.uint32(self.newest)):
                self.newest = int(version)
        return changed

    def most_informative(self, share: float, priority: NDArray[np.float64]) -> Contribution:
        """A contribution with that share of the blocks that is worth most, shape (blocks,)."""
        kept = Contribution(self._size, self.origin)
        chosen = np.sort(np.argsort(-priority, kind="stable")[: int(share * self.blocks)])
        for start in range(0, len(chosen), _KEPT_AT_ONCE):
            kept.accept(self.states(0, chosen[start : start + _KEPT_AT_ONCE]))
        kept.newest, kept.is_cut = self.newest, True
        return kept

    def add_to(
        self,
        indices: NDArray[np.int32],
        known: NDArray[np.bool_],
        quanta: NDArray[np.int32],
        information: NDArray[np.float64],
    ) -> None:
        """Add what is known of voxels to sums; see `contribution_kernels.add_contribution`."""
        kernels.add_contribution(
            self._blocks,
            self._planes,
            self._codes,
            self._size,
            code_tables(),
            indices,
            known,
            quanta,
            information,
            np.empty((5, 3)),
        )

    def states(self, robot: int, slots: NDArray[np.int64] | None = None) -> MapUpdate:
        """All states of blocks, also those that are not observed any more.

        Args:
            robot: id of the robot whose contribution it is.
            slots: numbers of the blocks, all if None.
        """
        slots = np.arange(self.blocks) if slots is None else slots
        count = int(kernels.count_known(self._planes, slots))
        update = MapUpdate(
            self._size,
            robot,
            np.zeros(count, np.uint32),
            np.zeros((count, 3), np.int32),
            np.zeros(count, np.int8),
            np.zeros((count, 2), np.uint64),
            origin=self.origin,
        )
        states = update.indices, update.versions, update.log_odds, update.codes
        kernels.list_known(self._blocks, self._planes, self._codes, slots, *states)
        return update

    def versions_of(self, indices: NDArray[np.int32]) -> NDArray[np.uint32]:
        """Versions of what was reported of voxels, 0 where nothing was, shape (K, 3) -> (K,)."""
        slots = np.full(len(indices), -1, np.int64)
        kernels.find_blocks(self._blocks, indices >> BLOCK_BITS, slots)
        places = indices & (BLOCK_SIDE - 1)
        local = places[:, 0] + BLOCK_SIDE * (places[:, 1] + BLOCK_SIDE * places[:, 2])
        versions = np.zeros(len(indices), np.uint32)
        there = slots >= 0
        versions[there] = self._planes.versions[slots[there], local[there]]
        return versions

    def hash(self) -> int:
        """Hash of all that is known, 64 bits; equal where the same is known."""
        hashes = np.zeros(self.blocks, np.uint64)
        kernels.hash_blocks(self._blocks, self._planes, hashes)
        return int(np.add.reduce(hashes, dtype=np.uint64))

    def cells(self, level: int, within: int = 0, corners: Corners | None = None) -> Cells:
        """Hashes of the cubes of 2^level blocks, of which something is known.

        Args:
            level: see above.
            within: level of `corners`.
            corners: cubes whose blocks count, shape (n, 3); all blocks if None.
        """
        slots = np.arange(self.blocks) if corners is None else self.slots_in(within, corners)
        hashes = np.zeros(len(slots), np.uint64)
        kernels.hash_some(self._blocks, self._planes, slots, hashes)
        slots, hashes = slots[hashes != 0], hashes[hashes != 0]
        found, groups = np.unique(self.coordinates(slots) >> level, axis=0, return_inverse=True)
        sums = np.zeros(len(found), np.uint64)
        np.add.at(sums, groups.reshape(-1), hashes)
        return Cells(level, found.astype(np.int32), _folded(sums))

    def compare(self, cells: Cells) -> NDArray[np.bool_]:
        """Where the hashes of cells of another replica differ from those here, (n,)."""
        here = self.cells(cells.level, cells.level, cells.corners)
        own = dict(zip(*_listed(here), strict=True))
        pairs = zip(*_listed(cells), strict=True)
        return np.array([own.get(corner, 0) != value for corner, value in pairs], np.bool_)

    def blocks_at(self, corners: Corners) -> tuple[NDArray[np.uint32], NDArray[np.uint32]]:
        """Hashes of blocks as in `cells`, and their newest versions; 0 where nothing was sent."""
        slots = np.full(len(corners), -1, np.int64)
        kernels.find_blocks(self._blocks, corners, slots)
        hashes = np.zeros(len(slots), np.uint64)
        kernels.hash_some(self._blocks, self._planes, slots, hashes)
        newest, there = np.zeros(len(slots), np.uint32), slots >= 0
        newest[there] = self._planes.newest[slots[there]]
        return _folded(hashes), newest

    def coordinates(self, slots: NDArray[np.int64]) -> NDArray[np.int32]:
        """Coordinates of blocks [blocks], shape (n, 3)."""
        coordinates = np.zeros((len(slots), 3), np.int32)
        kernels.unpack_keys(self._blocks.keys[slots], coordinates)
        return coordinates

    def slots_in(self, level: int, corners: NDArray[np.int32]) -> NDArray[np.int64]:
        """The blocks in cubes of 2^level blocks, which need not be there."""
        if level == 0:
            slots = np.full(len(corners), -1, np.int64)
            kernels.find_blocks(self._blocks, corners, slots)
            return slots[slots >= 0]
        own = pack_all(self.coordinates(np.arange(self.blocks)).astype(np.int64) >> level)
        return np.flatnonzero(np.isin(own, pack_all(corners.astype(np.int64))))


def _few_blocks() -> BlockArrays:
    """As `empty_blocks`, with little room, and none for what a contribution does not use."""
    arrays = empty_blocks()
    return arrays._replace(
        table=np.full(2 * _FIRST_BLOCKS, -1, np.int32),
        keys=arrays.keys[:_FIRST_BLOCKS].copy(),
        base=arrays.base[:_FIRST_BLOCKS].copy(),
        kind=arrays.kind[:_FIRST_BLOCKS].copy(),
        plane=arrays.plane[:_FIRST_BLOCKS].copy(),
        narrow=arrays.narrow[:0].copy(),
        wide=arrays.wide[:0].copy(),
        free_rows=arrays.free_rows[:0].copy(),
    )


def _grown_to(room: int, needed: int, more: float = 0.5) -> int:
    """Rows of an array after `blocks.grown` or `with_room` has made room."""
    return room if room >= needed else max(needed, room + int(more * room))


def _folded(hashes: NDArray[np.uint64]) -> NDArray[np.uint32]:
    """32 of 64 bits."""
    return (hashes ^ (hashes >> np.uint64(32))).astype(np.uint32)


def _listed(cells: Cells) -> tuple[list[tuple[int, ...]], list[int]]:
    return [tuple(corner) for corner in cells.corners.tolist()], cells.hashes.tolist()


def _grown_planes(planes: Planes, blocks: int) -> Planes:
    used = len(planes.newest)
    if used >= blocks:
        return planes
    return Planes(
        grown(planes.log_odds, blocks, NOT_OBSERVED),
        grown(planes.versions, blocks, 0),
        grown(planes.newest, blocks, 0),
        grown(planes.hashes, blocks, 0),
    )
