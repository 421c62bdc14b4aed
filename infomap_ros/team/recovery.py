"""A robot that has started again gets back what others know of its contribution."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit

from infomap_ros.mapping import NOT_OBSERVED, VoxelMap
from infomap_ros.mapping.voxels.block_kernels import find_block
from infomap_ros.mapping.voxels.keys import BLOCK_BITS, local_index, pack
from infomap_ros.mapping.voxels.storage import Growth
from infomap_ros.mapping.voxels.voxel_states import (
    VoxelStates,
    count_block_changes,
    put_states,
)
from infomap_ros.team.gaussian_code import information_of_codes
from infomap_ros.team.update import MapUpdate


def adopt(own_map: VoxelMap, update: MapUpdate) -> None:
    """Put told states into a map, but for voxels that have changed; they count as changes.

    What a robot told is newer than the file from which it starts again, but not newer than what
    it sees since then.

    Args:
        own_map: tracks its changes since it was read.
        update: states of its contribution as another robot heard them.

    Raises:
        CapacityError: with them it would take more than half of its memory limit.
    """
    fresh = np.zeros(len(update.versions), np.bool_)
    _find_changed(own_map._storage.blocks, update.indices, fresh)
    update = update.rows(~fresh & (update.log_odds != NOT_OBSERVED))
    information = information_of_codes(update.codes, own_map.config.voxel_size)
    states = VoxelStates(
        update.indices,
        np.ones(len(update.versions), np.bool_),
        update.log_odds.astype(np.int32),
        information.astype(np.float32),
    )
    blocks, surfaces = int(count_block_changes(update.indices)), int(update.has_gaussian.sum())
    more = Growth(blocks, blocks, min(blocks, surfaces), surfaces)
    own_map._storage.check_growth(more, 0.5e9 * own_map.config.memory_limit)
    put_states(own_map._storage, states)


@njit(cache=True, nogil=True)
def _find_changed(blocks: Any, indices: Any, changed: Any) -> None:
    for row in range(len(indices)):
        x, y, z = indices[row, 0], indices[row, 1], indices[row, 2]
        slot = find_block(blocks, pack(x >> BLOCK_BITS, y >> BLOCK_BITS, z >> BLOCK_BITS))
        if slot >= 0:
            local = local_index(x, y, z)
            word = blocks.dirty[slot, local >> 6] >> np.uint64(local & 63)
            changed[row] = (word & np.uint64(1)) != np.uint64(0)
