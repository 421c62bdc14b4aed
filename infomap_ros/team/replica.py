"""A replica of the map that a team shares.

Each robot owns its contribution and tells the absolute states of its voxels. A replica keeps, per
robot and voxel, the newest state that it heard, and the sum over the robots stands in a map. So
updates may be lost, repeated or come in any order: nothing is counted twice, and replicas that
have heard the same hold the same voxels with the same bits. Sums run over the robots in the order
of their ids, because sums of floating-point numbers depend on their order.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from infomap_ros.errors import CapacityError, InvalidInputError
from infomap_ros.mapping import VoxelMap, VoxelMapConfig
from infomap_ros.mapping.block_kernels import find_or_add_block
from infomap_ros.mapping.blocks import BLOCK_COUNT, with_room
from infomap_ros.mapping.keys import (
    BLOCK_BITS,
    BLOCK_VOXELS,
    COORDINATE_LIMIT,
    local_index,
    pack,
)
from infomap_ros.mapping.storage import MapStorage, growth_bytes
from infomap_ros.mapping.voxel_states import (
    VoxelStates,
    add_states,
    count_block_changes,
    information_of,
    put_states,
    unknown_states,
)
from infomap_ros.team.versions import is_newer
from infomap_ros.team.wire import NOT_OBSERVED, MapUpdate

_VERSION_BYTES = 4 * BLOCK_VOXELS


@dataclass
class _Contribution:
    """What one robot told: its voxels, and the version of each, shape (blocks, 512)."""

    storage: MapStorage = field(default_factory=MapStorage)
    versions: NDArray[np.uint32] = field(
        default_factory=lambda: np.zeros((0, BLOCK_VOXELS), np.uint32)
    )

    def memory_bytes(self) -> int:
        blocks = int(self.storage.blocks.counts[BLOCK_COUNT])
        return self.storage.memory_bytes() + blocks * _VERSION_BYTES

    def accept(self, states: VoxelStates, version: int) -> VoxelStates:
        """Keep the states that are newer than what was heard; returns those that are other."""
        room = count_block_changes(states.indices)
        self.storage.blocks = with_room(self.storage.blocks, room, 0)
        self.versions = _grown_versions(self.versions, len(self.storage.blocks.keys))
        newer = np.zeros(len(states.quanta), np.bool_)
        _take_newer(self.storage.blocks, self.versions, states.indices, np.uint32(version), newer)
        states = states.rows(newer)
        return states.rows(put_states(self.storage, states))


class MapReplica:
    """The newest state of every voxel of every robot, and the map that is their sum.

    A voxel of the map is known when a robot knows it; its evidence and its information are the
    sums of what the robots know.

    Args:
        config: of the map.
    """

    def __init__(self, config: VoxelMapConfig | None = None) -> None:
        self._map = VoxelMap(config)
        self._contributions: dict[int, _Contribution] = {}

    @property
    def voxel_map(self) -> VoxelMap:
        """The sum over all robots. It is the replica's own: read it only."""
        return self._map

    @property
    def robots(self) -> tuple[int, ...]:
        """Ids of the robots that were heard, ascending."""
        return tuple(sorted(self._contributions))

    def memory_bytes(self) -> int:
        """Memory in use by the contributions and their sum [bytes]."""
        parts = sum(part.memory_bytes() for part in self._contributions.values())
        return parts + self._map.memory_bytes()

    def apply(self, update: MapUpdate) -> int:
        """Learn what a robot tells.

        Args:
            update: states of voxels, each voxel once, in voxels of the map's size.

        Returns:
            Number of voxels of which the robot now says something else than before.

        Raises:
            InvalidInputError: another voxel size, a voxel outside the coordinate limits, or a
                Gaussian that cannot be inverted. The replica is as it was.
            CapacityError: the replica would exceed ``memory_limit`` of the map. Likewise.
        """
        states = self._states_of(update)
        self._check_capacity(states)
        contribution = self._contributions.setdefault(update.robot, _Contribution())
        changed = contribution.accept(states, update.version)
        sums = unknown_states(changed.indices)
        for robot in self.robots:
            add_states(self._contributions[robot].storage, sums)
        put_states(self._map._storage, sums)
        return len(changed.quanta)

    def _states_of(self, update: MapUpdate) -> VoxelStates:
        size = self._map.config.voxel_size
        if np.float32(update.voxel_size) != np.float32(size):
            raise InvalidInputError(
                "map update", f"voxels of {update.voxel_size:g} m, the map has {size:g} m"
            )
        indices = update.indices
        if ((indices < -COORDINATE_LIMIT) | (indices >= COORDINATE_LIMIT)).any():
            raise InvalidInputError("map update", "a voxel lies outside the coordinate limits")
        known = update.log_odds != NOT_OBSERVED
        quanta = np.where(known, update.log_odds, 0).astype(np.int32)
        surface = update.has_gaussian & known
        information = information_of(indices, surface, update.means, update.covariances, size)
        return VoxelStates(indices, known, quanta, information)

    def _check_capacity(self, states: VoxelStates) -> None:
        blocks = count_block_changes(states.indices)
        surfaces = int(np.count_nonzero(states.information[:, 0]))
        growth = 2 * growth_bytes(self._map._storage, blocks, blocks, surfaces)
        used, limit = self.memory_bytes(), self._map.config.memory_limit * 1e9
        if used + growth + blocks * _VERSION_BYTES > limit:
            raise CapacityError(
                f"the shared map holds {used / 1e9:.3g} GB and this update could bring it above "
                f"the limit of {limit / 1e9:g} GB"
            )


def _grown_versions(versions: NDArray[np.uint32], blocks: int) -> NDArray[np.uint32]:
    if len(versions) >= blocks:
        return versions
    larger = np.zeros((blocks, BLOCK_VOXELS), np.uint32)
    larger[: len(versions)] = versions
    return larger


@njit(cache=True, nogil=True)
def _take_newer(blocks: Any, versions: Any, indices: Any, version: Any, newer: Any) -> None:
    """Tell for which voxels a version is newer than that which was heard, and remember it."""
    last_key, slot = np.int64(-1), np.int64(-1)
    for row in range(len(indices)):
        x, y, z = indices[row, 0], indices[row, 1], indices[row, 2]
        key = pack(x >> BLOCK_BITS, y >> BLOCK_BITS, z >> BLOCK_BITS)
        if key != last_key:
            slot, last_key = np.int64(find_or_add_block(blocks, key)), key
        local = local_index(x, y, z)
        if is_newer(version, versions[slot, local]):
            newer[row] = True
            versions[slot, local] = version
