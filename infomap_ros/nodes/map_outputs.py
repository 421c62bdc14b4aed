"""What map_fusion publishes of its map. Nothing is built that nobody subscribes to."""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np
from nav_msgs.msg import OccupancyGrid
from rclpy.publisher import Publisher
from sensor_msgs.msg import PointCloud2

from infomap_ros.geometry.config import check_config, parameter
from infomap_ros.mapping import VoxelChanges, VoxelMap
from infomap_ros.mapping.projection import ProjectionConfig, project_map
from infomap_ros.nodes import qos
from infomap_ros.nodes.base import MonitoredNode
from infomap_ros.nodes.map_contents import (
    VOXEL_MAP_FIELDS,
    voxel_map_rows,
    whole_map,
    without_evidence,
)
from infomap_ros.nodes.message_types import RclpyMessageTypes
from infomap_ros.nodes.scan_gate import ScanGateConfig
from infomap_ros.replay.messages import encode_cloud_fields, encode_occupancy_grid
from infomap_ros.replay.messages.rows import encode_rows
from infomap_ros.team import OCCUPANCY_ROW, MapUpdate, encode_update, next_version, version_at


@dataclass(frozen=True)
class MapOutputsConfig:
    """What map_fusion publishes.

    Raises:
        ConfigError: a value is out of its range.
    """

    robot_id: int = parameter(
        0, "Id of this robot in map_updates, unique in its team.", low=0, high=65535
    )
    voxel_map_period: float = parameter(
        1.0,
        "Shortest time between two messages on voxel_map and projected_map.",
        unit="s",
        low=0.05,
        high=3600.0,
    )

    def __post_init__(self) -> None:
        check_config(self)


class MapOutputs:
    """The publishers of a map.

    Args:
        node: the node that publishes.
    """

    def __init__(self, node: MonitoredNode) -> None:
        self._config = node.config(MapOutputsConfig)
        self._frame = node.config(ScanGateConfig).map_frame
        self._projection = node.config(ProjectionConfig)
        self._types = RclpyMessageTypes()
        self._version = version_at(time.time_ns())
        self._whole_map_due = False
        self._outdated = {"voxel_map", "projected_map"}
        self._updates = node.advertise(PointCloud2, "map_updates", qos.stream(depth=50))
        self._voxel_map = node.advertise(PointCloud2, "voxel_map", qos.latched())
        self._projected = node.advertise(OccupancyGrid, "projected_map", qos.latched())

    @property
    def pictures_period(self) -> float:
        """Shortest time between two pictures [s]."""
        return self._config.voxel_map_period

    def publish_changes(self, voxel_map: VoxelMap, stamp: int) -> None:
        """Send the voxels that changed since they were last sent.

        While nobody listens they stay marked: values are absolute, so who comes later gets them
        with the next scan. There is a message for every scan, an empty one if nothing changed.
        """
        self._outdated = {"voxel_map", "projected_map"}
        if not self._updates.get_subscription_count():
            return
        changes = voxel_map.take_changes()
        if self._whole_map_due:
            changes = whole_map(voxel_map)
            self._whole_map_due = False
        self._publish_update(changes, voxel_map.config.voxel_size, stamp)

    def replace(self, old: VoxelMap, new: VoxelMap, stamp: int) -> None:
        """Take back every voxel of the old map, then send every voxel of the new one.

        A voxel is taken back by saying that it was not observed.
        """
        if self._updates.get_subscription_count():
            indices, _ = old.voxels()
            self._publish_update(without_evidence(indices), old.config.voxel_size, stamp)
        self._whole_map_due = True
        self.publish_changes(new, stamp)

    def publish_pictures(self, voxel_map: VoxelMap, stamp: int) -> None:
        """Send voxel_map and projected_map if the map has changed and somebody listens.

        Who comes later gets the last of them from the middleware.
        """
        if self._wanted("voxel_map", self._voxel_map):
            rows = voxel_map_rows(voxel_map)
            self._voxel_map.publish(
                encode_cloud_fields(self._types, stamp, self._frame, VOXEL_MAP_FIELDS, rows)
            )
        if self._wanted("projected_map", self._projected):
            self._projected.publish(self._project(voxel_map, stamp))

    def _wanted(self, topic: str, publisher: Publisher) -> bool:
        wanted = topic in self._outdated and publisher.get_subscription_count() > 0
        if wanted:
            self._outdated.remove(topic)
        return wanted

    def _project(self, voxel_map: VoxelMap, stamp: int) -> OccupancyGrid:
        grid = project_map(voxel_map, self._projection)
        return encode_occupancy_grid(
            self._types, stamp, self._frame, grid.cells, grid.resolution, grid.origin
        )

    def _publish_update(self, changes: VoxelChanges, voxel_size: float, stamp: int) -> None:
        self._version = next_version(self._version)
        update = MapUpdate(
            voxel_size,
            self._config.robot_id,
            self._version,
            changes.indices,
            changes.log_odds,
            changes.has_gaussian,
            changes.means,
            changes.covariances,
        )
        for rows in encode_update(update) or [np.zeros(0, OCCUPANCY_ROW)]:
            message = encode_rows(self._types, stamp, self._frame, rows)
            self._updates.publish(message)
