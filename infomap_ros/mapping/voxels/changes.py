"""What changed in a map, for those who keep a copy of it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from infomap_ros.errors import InvalidInputError
from infomap_ros.geometry.pose_uncertainty import point_covariances
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.mapping.voxels import queries
from infomap_ros.mapping.voxels.keys import BLOCK_COUNT
from infomap_ros.mapping.voxels.storage import MapStorage


@dataclass(frozen=True, eq=False)
class VoxelChanges:
    """Voxels that changed since they were last asked for; absolute values, not differences.

    Covariances hold all errors, also that which the whole map shares: that of another robot is
    independent of it, so who merges maps of robots weighs them rightly.

    Attributes:
        indices: voxel indices, shape (K, 3), int32.
        log_odds: occupancy evidence in units of LOG_ODDS_QUANTUM, clipped to +-
            SHARED_LOG_ODDS_LIMIT, or NOT_OBSERVED for a voxel that was known and is no more, shape
            (K,), int8.
        has_gaussian: whether the voxel holds a surface, shape (K,), bool.
        means: of the surface point, shape (K, 3) [m]; NaN where there is none.
        covariances: shape (K, 3, 3) [m^2]; NaN where there is none.
    """

    indices: NDArray[np.int32]
    log_odds: NDArray[np.int8]
    has_gaussian: NDArray[np.bool_]
    means: FloatArray
    covariances: FloatArray


def take_changes(
    storage: MapStorage, size: float, limit: int, slots: NDArray[np.int64] | None = None
) -> VoxelChanges:
    """Implementation of `VoxelMap.take_changes` for voxels of `size` [m].

    Args:
        storage: of the map.
        size: see above.
        limit: number of voxels at the most.
        slots: numbers of the blocks of which changes are taken, in this order; all if None.
    """
    blocks = storage.blocks
    if len(blocks.dirty) == 0:
        raise InvalidInputError("take_changes", "changes are not tracked")
    count = int(blocks.counts[BLOCK_COUNT])
    slots = np.arange(count) if slots is None else slots
    room = min(limit, int(_count_bits(blocks.dirty[slots].reshape(-1))))
    indices, quanta = np.empty((room, 3), np.int32), np.empty(room, np.int8)
    owners = np.empty(room, np.int64)
    found = queries.list_dirty(blocks, storage.gone, slots, room, indices, quanta, owners)
    indices, quanta, owners = indices[:found], quanta[:found], owners[:found]
    has_gaussian = np.empty(found, np.bool_)
    means, covariances = np.full((found, 3), np.nan), np.full((found, 3, 3), np.nan)
    queries.describe_surface(
        storage.gaussians,
        size,
        indices,
        quanta,
        owners,
        has_gaussian,
        means,
        covariances,
    )
    if storage.offset.any():
        covariances[has_gaussian] += point_covariances(storage.offset, means[has_gaussian])
    return VoxelChanges(indices, quanta, has_gaussian, means, covariances)


def changed_blocks(storage: MapStorage) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Blocks with changes that were not yet taken: their numbers, and how many voxels each."""
    if len(storage.blocks.dirty) == 0:
        raise InvalidInputError("changed_blocks", "changes are not tracked")
    dirty = storage.blocks.dirty[: int(storage.blocks.counts[BLOCK_COUNT])]
    slots = np.flatnonzero((dirty != 0).any(axis=1))
    return slots, np.array([_count_bits(dirty[slot]) for slot in slots], np.int64)


def mark_changed(storage: MapStorage, first: int, blocks: int) -> int:
    """Implementation of `VoxelMap.mark_changed`."""
    if len(storage.blocks.dirty) == 0:
        raise InvalidInputError("mark_changed", "changes are not tracked")
    count = int(storage.blocks.counts[BLOCK_COUNT])
    end = min(first + blocks, count)
    storage.blocks.dirty[first:end] = np.uint64(0xFFFFFFFFFFFFFFFF)
    return count - end


def put_offset(storage: MapStorage, offset: FloatArray) -> None:
    """Replace the covariance of the error that the whole map shares, shape (6, 6).

    All surface points count as changed when its variances are no more those with which they were
    taken, by a quarter or more: their standard deviations may be other by an eighth.
    """
    storage.offset = offset
    now, before = np.diag(offset), np.diag(storage.taken_offset)
    if (np.abs(now - before) > 0.25 * np.maximum(now, before)).any():
        storage.taken_offset = offset
        if len(storage.blocks.dirty):
            mark_changed(storage, 0, int(storage.blocks.counts[BLOCK_COUNT]))


@njit(nogil=True, cache=True)
def _count_bits(words: NDArray[np.uint64]) -> int:
    """Number of ones, for words of 64 bits (numpy has it from 2.0 on, ROS Jazzy has numpy 1.26)."""
    total = 0
    for word in words:
        pairs = word - ((word >> np.uint64(1)) & np.uint64(0x5555555555555555))
        low, high = pairs & np.uint64(0x3333333333333333), pairs >> np.uint64(2)
        fours = low + (high & np.uint64(0x3333333333333333))
        octets = (fours + (fours >> np.uint64(4))) & np.uint64(0x0F0F0F0F0F0F0F0F)
        sixteens = (octets + (octets >> np.uint64(8))) & np.uint64(0x00FF00FF00FF00FF)
        halves = (sixteens + (sixteens >> np.uint64(16))) & np.uint64(0x0000FFFF0000FFFF)
        total += int((halves + (halves >> np.uint64(32))) & np.uint64(0xFFFFFFFF))
    return total
