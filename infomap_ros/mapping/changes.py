"""What changed in a map, for those who keep a copy of it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from infomap_ros.errors import InvalidInputError
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.mapping import queries
from infomap_ros.mapping.blocks import BLOCK_COUNT
from infomap_ros.mapping.storage import MapStorage


@dataclass(frozen=True, eq=False)
class VoxelChanges:
    """Voxels that changed since they were last asked for; absolute values, not differences.

    Attributes:
        indices: voxel indices, shape (K, 3), int32.
        log_odds: occupancy evidence in units of LOG_ODDS_QUANTUM, clipped to +-
            SHARED_LOG_ODDS_LIMIT, shape (K,), int8.
        has_gaussian: whether the voxel holds a surface, shape (K,), bool.
        means: of the surface point, shape (K, 3) [m]; NaN where there is none.
        covariances: shape (K, 3, 3) [m^2]; NaN where there is none.
    """

    indices: NDArray[np.int32]
    log_odds: NDArray[np.int8]
    has_gaussian: NDArray[np.bool_]
    means: FloatArray
    covariances: FloatArray


def take_changes(storage: MapStorage, size: float, limit: int) -> VoxelChanges:
    """Implementation of `VoxelMap.take_changes` for voxels of `size` [m]."""
    blocks = storage.blocks
    if len(blocks.dirty) == 0:
        raise InvalidInputError("take_changes", "changes are not tracked")
    count = int(blocks.counts[BLOCK_COUNT])
    room = min(limit, int(np.bitwise_count(blocks.dirty[:count]).sum()))
    indices, quanta = np.empty((room, 3), np.int32), np.empty(room, np.int8)
    owners = np.empty(room, np.int64)
    found = queries.list_dirty(blocks, room, indices, quanta, owners)
    indices, quanta, owners = indices[:found], quanta[:found], owners[:found]
    has_gaussian = np.empty(found, np.bool_)
    means, covariances = np.full((found, 3), np.nan), np.full((found, 3, 3), np.nan)
    queries.describe_surface(
        blocks,
        storage.gaussians,
        size,
        indices,
        quanta,
        owners,
        has_gaussian,
        means,
        covariances,
    )
    return VoxelChanges(indices, quanta, has_gaussian, means, covariances)
