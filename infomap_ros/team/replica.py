"""A replica of the map that a team shares.

Each robot owns its contribution and tells the absolute states of its voxels. A replica keeps, per
robot and voxel, the newest state that it heard, and the sum over the robots stands in a map. So
updates may be lost, repeated or come in any order: nothing is counted twice, and replicas that
have heard the same hold the same voxels with the same bits. Sums run over the robots in the order
of their ids, because sums of floating-point numbers depend on their order.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from infomap_ros.errors import CapacityError, InvalidInputError
from infomap_ros.mapping import VoxelMap, VoxelMapConfig
from infomap_ros.mapping.voxels.storage import Growth, growth_bytes
from infomap_ros.mapping.voxels.voxel_states import (
    VoxelStates,
    count_block_changes,
    put_states,
)
from infomap_ros.team.contribution import BLOCK_BYTES, CODE_BYTES, Contribution
from infomap_ros.team.contribution_kernels import mixed
from infomap_ros.team.update import MapUpdate


class MapReplica:
    """The newest state of every voxel of every robot, and the map that is their sum.

    A voxel of the map is known when a robot knows it; its evidence and its information are the
    sums of what the robots know.

    Args:
        config: of the map.
    """

    def __init__(self, config: VoxelMapConfig | None = None) -> None:
        self._map = VoxelMap(config)
        self._contributions: dict[int, Contribution] = {}
        self._aside: set[int] = set()

    @property
    def voxel_map(self) -> VoxelMap:
        """The sum over all robots. It is the replica's own: read it only."""
        return self._map

    @property
    def robots(self) -> tuple[int, ...]:
        """Ids of the robots that were heard, ascending."""
        return tuple(sorted(self._contributions))

    def contribution(self, robot: int) -> Contribution | None:
        """What a robot told, None where nothing was heard. It is the replica's own."""
        return self._contributions.get(robot)

    def hash(self) -> int:
        """Hash of all contributions, 64 bits: replicas that have heard the same have the same."""
        parts = [mixed(mixed(robot) ^ np.uint64(part.hash())) for robot, part in self._parts()]
        return int(np.add.reduce(np.array(parts, np.uint64), dtype=np.uint64))

    def memory_bytes(self) -> int:
        """Memory in use by the contributions and their sum [bytes]."""
        parts = sum(part.memory_bytes() for part in self._contributions.values())
        return parts + self._map.memory_bytes()

    def apply(self, update: MapUpdate) -> int:
        """As `accept`; returns the number of voxels of which the robot now says something else."""
        return int(np.count_nonzero(self.accept(update)))

    def accept(self, update: MapUpdate) -> NDArray[np.bool_]:
        """Learn what a robot tells.

        Args:
            update: states of voxels, each voxel once, in voxels of the map's size.

        Returns:
            Of which voxels the robot now says something else than before, shape (K,).

        Raises:
            InvalidInputError: another voxel size or impossible states. The replica is as it was.
            CapacityError: the replica would exceed ``memory_limit`` of the map. Likewise.
        """
        size = self._map.config.voxel_size
        if np.float32(update.voxel_size) != np.float32(size):
            raise InvalidInputError(
                "map update", f"voxels of {update.voxel_size:g} m, the map has {size:g} m"
            )
        update.check_states()
        self._check_capacity(update)
        contribution = self._contributions.get(update.robot, Contribution(size))
        changed = contribution.accept(update)
        self._contributions[update.robot] = contribution
        if update.robot not in self._aside:
            self._add_up(update.indices[changed])
        return changed

    def set_aside(self, robot: int, aside: bool) -> None:
        """Leave a robot's contribution out of the map, or put it back; it is kept all the same."""
        if aside == (robot in self._aside):
            return
        self._aside ^= {robot}
        contribution = self._contributions.get(robot)
        if contribution is not None:
            self._add_up(contribution.states(robot).indices)

    @property
    def aside(self) -> tuple[int, ...]:
        """Ids of the robots whose contributions are left out of the map."""
        return tuple(sorted(self._aside))

    def _parts(self) -> list[tuple[int, Contribution]]:
        return [(robot, self._contributions[robot]) for robot in self.robots]

    def _add_up(self, indices: NDArray[np.int32]) -> None:
        """Set voxels of the map to the sums over the robots."""
        count = len(indices)
        known, quanta = np.zeros(count, np.bool_), np.zeros(count, np.int32)
        information = np.zeros((count, 9))
        for robot, part in self._parts():
            if robot not in self._aside:
                part.add_to(indices, known, quanta, information)
        states = VoxelStates(indices, known, quanta, information.astype(np.float32))
        put_states(self._map._storage, states)

    def _check_capacity(self, update: MapUpdate) -> None:
        blocks = int(count_block_changes(update.indices))
        surfaces = int(np.count_nonzero(update.has_gaussian))
        more = Growth(blocks, blocks, min(surfaces, blocks), surfaces)
        self._map._storage.check_growth(more)
        growth = growth_bytes(self._map._storage, more)
        growth += blocks * (BLOCK_BYTES + 40) + surfaces * (CODE_BYTES + 8)
        used, limit = self.memory_bytes(), self._map.config.memory_limit * 1e9
        if used + growth > limit:
            raise CapacityError(
                f"the shared map holds {used / 1e9:.3g} GB and this update could bring it above "
                f"the limit of {limit / 1e9:g} GB"
            )
