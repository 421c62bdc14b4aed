"""The pictures that map_fusion publishes of its map. Nothing is built that nobody subscribes to."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

from nav_msgs.msg import OccupancyGrid
from rclpy.publisher import Publisher
from sensor_msgs.msg import PointCloud2

from infomap_ros.geometry.config import check_config, parameter
from infomap_ros.mapping import VoxelMap
from infomap_ros.mapping.files.projection import ProjectionConfig, project_map
from infomap_ros.messages import encode_cloud_fields, encode_occupancy_grid
from infomap_ros.nodes.common import qos
from infomap_ros.nodes.common.base import MonitoredNode
from infomap_ros.nodes.common.message_types import RclpyMessageTypes
from infomap_ros.nodes.fusion.map_contents import VOXEL_MAP_FIELDS, voxel_map_rows
from infomap_ros.pipeline.scan_synchronizer import ScanSynchronizerConfig


@dataclass(frozen=True)
class MapOutputsConfig:
    """When pictures of the map are published.

    Raises:
        ConfigError: a value is out of its range.
    """

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
    """The publishers of the pictures of a map.

    Args:
        node: the node that publishes.
        on_wanted: called when a subscriber has appeared, who is to get the map as it is now.
    """

    def __init__(self, node: MonitoredNode, on_wanted: Callable[[], object]) -> None:
        self._config = node.config(MapOutputsConfig)
        self._frame = node.config(ScanSynchronizerConfig).map_frame
        self._projection = node.config(ProjectionConfig)
        self._types = RclpyMessageTypes()
        self._outdated = {"voxel_map", "projected_map"}

        def show(topic: str) -> None:
            self._outdated.add(topic)
            on_wanted()

        show_voxels, show_grid = (partial(show, topic) for topic in ("voxel_map", "projected_map"))
        self._voxel_map = node.advertise(PointCloud2, "voxel_map", qos.current(), show_voxels)
        self._projected = node.advertise(OccupancyGrid, "projected_map", qos.current(), show_grid)

    @property
    def pictures_period(self) -> float:
        """Shortest time between two pictures [s]."""
        return self._config.voxel_map_period

    def changed(self) -> None:
        """The map is another than in the last pictures."""
        self._outdated = {"voxel_map", "projected_map"}

    def publish_pictures(self, voxel_map: VoxelMap, stamp: int) -> None:
        """Send voxel_map and projected_map to who listens, if they changed or somebody is new.

        Nothing is sent before anything is known.
        """
        if not stamp and not voxel_map.known_voxels:
            return
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
