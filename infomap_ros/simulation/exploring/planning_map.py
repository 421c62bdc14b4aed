"""The map as whoever plans knows it: by the updates that map_fusion publishes."""

from __future__ import annotations

from infomap_ros.mapping import VoxelMap, VoxelMapConfig
from infomap_ros.team import MapReplica, MapUpdate, decode_update, encode_update, next_version
from infomap_ros.team.config import TeamConfig

_ROBOT, _SESSION = 1, 1


class PlanningMap:
    """A replica of a robot's map. Updates are rounded, so it is not quite the map itself.

    Args:
        voxel_map: of the robot; its changes are tracked from now on.
    """

    def __init__(self, voxel_map: VoxelMap) -> None:
        self._own, self._version = voxel_map, 1
        voxel_map.track_changes(True)
        size, limit = voxel_map.config.voxel_size, voxel_map.config.memory_limit
        self._replica = MapReplica(VoxelMapConfig(voxel_size=size, memory_limit=limit))
        self._message_size = TeamConfig().message_size

    def current(self) -> VoxelMap:
        """What is known now; to be read only.

        Raises:
            CapacityError: it does not fit into the memory limit of the map.
        """
        changes = self._own.take_changes()
        if len(changes.indices):
            self._version = next_version(self._version)
            size = self._own.config.voxel_size
            update = MapUpdate.of_changes(changes, size, _ROBOT, self._version, _SESSION)
            for rows in encode_update(update, self._message_size):
                self._replica.accept(decode_update(rows))
        return self._replica.voxel_map
