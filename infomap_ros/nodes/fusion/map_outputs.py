"""The pictures that map_fusion publishes of its map. Nothing is built that nobody subscribes to.

The content of a voxel map in the forms in which it is published.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from nav_msgs.msg import OccupancyGrid
from numpy.typing import NDArray
from rclpy.publisher import Publisher
from sensor_msgs.msg import PointCloud2

from infomap_ros.mapping import NOT_OBSERVED, VoxelChanges, VoxelMap
from infomap_ros.mapping.files.export import (
    DistanceConfig,
    ProjectionConfig,
    obstacle_distances,
    project_map,
    surface_vertices,
)
from infomap_ros.mapping.files.octomap_file import binary_tree, full_tree
from infomap_ros.messages import encode_cloud_fields, encode_occupancy_grid
from infomap_ros.messages.encode import OCTOMAP, encode_octomap
from infomap_ros.nodes.common import qos
from infomap_ros.nodes.common.base import MonitoredNode
from infomap_ros.nodes.common.message_types import RclpyMessageTypes, message_class
from infomap_ros.pipeline.scan_synchronizer import ScanSynchronizerConfig

VOXEL_MAP_FIELDS = ("x", "y", "z", "probability", "sigma")
DISTANCE_FIELDS = ("x", "y", "z", "intensity")  # as RViz, Voxblox and nvblox name a distance


def voxel_map_rows(voxel_map: VoxelMap) -> NDArray[np.float32]:
    """Surface voxels as rows of `VOXEL_MAP_FIELDS`, shape (K, 5), float32.

    Position is the mean of the Gaussian [m, map]; sigma is the standard deviation of the surface
    along its normal [m].
    """
    vertices = surface_vertices(voxel_map)
    return np.stack([vertices[name].astype(np.float32) for name in VOXEL_MAP_FIELDS], axis=-1)


def without_evidence(indices: NDArray[np.int32]) -> VoxelChanges:
    """Voxels, shape (K, 3), of which nothing is known."""
    count = len(indices)
    return VoxelChanges(
        indices,
        np.full(count, NOT_OBSERVED, np.int8),
        np.zeros(count, np.bool_),
        np.full((count, 3), np.nan),
        np.full((count, 3, 3), np.nan),
    )


VOXEL_MAP, PROJECTED_MAP = "voxel_map", "projected_map"
OCTOMAP_BINARY, OCTOMAP_FULL = "octomap_binary", "octomap_full"


_PERIOD = 1.0  # shortest between two messages of one picture [s]
_PAUSE = 4.0  # distances take a fifth of the time of the thread that integrates scans, at most


@dataclass(eq=False)
class _Picture:
    """A topic with what builds its message of a map and a stamp [ns].

    One that was built rests `pause` times as long, or until there is a new subscriber.
    """

    publisher: Publisher
    build: Callable[[VoxelMap, int], Any]
    pause: float = 0.0
    is_outdated: bool = True
    rests_until: float = -math.inf

    def publish(self, voxel_map: VoxelMap, stamp: int) -> None:
        begin = time.monotonic()
        self.publisher.publish(self.build(voxel_map, stamp))
        end = time.monotonic()
        self.rests_until = end + self.pause * (end - begin)


class MapOutputs:
    """The publishers of the pictures of a map.

    Args:
        node: the node that publishes.
        on_wanted: called when a subscriber has appeared, who is to get the map as it is now.

    Attributes:
        has_octomap: whether octomap_msgs is installed.
    """

    def __init__(self, node: MonitoredNode, on_wanted: Callable[[], object]) -> None:
        self._node, self._on_wanted = node, on_wanted
        self._frame = node.config(ScanSynchronizerConfig).map_frame
        self._projection = node.config(ProjectionConfig)
        self._distances = node.config(DistanceConfig)
        self._types = RclpyMessageTypes()
        self._pictures: dict[str, _Picture] = {}
        show_voxels, show_grid = (partial(self._show, name) for name in (VOXEL_MAP, PROJECTED_MAP))
        voxels = node.advertise(PointCloud2, "voxel_map", qos.current(), show_voxels)
        grids = node.advertise(OccupancyGrid, "projected_map", qos.current(), show_grid)
        self._pictures[VOXEL_MAP] = _Picture(voxels, self._voxels)
        self._pictures[PROJECTED_MAP] = _Picture(grids, self._project)
        for topic, band in (("distance_field", None), ("distance_slice", self._projection)):
            rows = node.advertise(PointCloud2, topic, qos.current(), partial(self._show, topic))
            self._pictures[topic] = _Picture(rows, partial(self._measure, band=band), _PAUSE)
        self.has_octomap = True
        try:
            kind = message_class(OCTOMAP)
        except ModuleNotFoundError:
            self.has_octomap = False
            node.get_logger().info("no octomap topics and services: octomap_msgs is not installed")
            return
        for topic, binary in ((OCTOMAP_BINARY, True), (OCTOMAP_FULL, False)):
            trees = node.advertise(kind, topic, qos.current(), partial(self._show, topic))
            self._pictures[topic] = _Picture(trees, partial(self._octomap, binary=binary))

    @property
    def pictures_period(self) -> float:
        """Shortest time between two pictures [s]."""
        return _PERIOD

    def changed(self) -> None:
        """The map is another than in the last pictures."""
        for picture in self._pictures.values():
            picture.is_outdated = True

    def publish_pictures(self, voxel_map: VoxelMap, stamp: int) -> None:
        """Send pictures to who listens, if they changed or somebody is new.

        Nothing is sent before anything is known.
        """
        if not stamp and not voxel_map.known_voxels:
            return
        for topic, picture in self._pictures.items():
            if not picture.is_outdated or time.monotonic() < picture.rests_until:
                continue
            if picture.publisher.get_subscription_count() > 0:
                picture.is_outdated = False
                self._node.guard(topic, partial(picture.publish, voxel_map, stamp))

    def picture(self, topic: str, voxel_map: VoxelMap, stamp: int) -> Any:
        """The message of a topic for a map as it is now.

        Raises:
            InvalidInputError: the map reaches too far for an octree.
        """
        return self._pictures[topic].build(voxel_map, stamp)

    def _show(self, topic: str) -> None:
        """Somebody has subscribed."""
        if topic in self._pictures:
            self._pictures[topic].is_outdated = True
            self._pictures[topic].rests_until = -math.inf
        self._on_wanted()

    def _voxels(self, voxel_map: VoxelMap, stamp: int) -> Any:
        rows = voxel_map_rows(voxel_map)
        return encode_cloud_fields(self._types, stamp, self._frame, VOXEL_MAP_FIELDS, rows)

    def _project(self, voxel_map: VoxelMap, stamp: int) -> Any:
        grid = project_map(voxel_map, self._projection)
        return encode_occupancy_grid(
            self._types, stamp, self._frame, grid.cells, grid.resolution, grid.origin
        )

    def _measure(self, voxel_map: VoxelMap, stamp: int, band: ProjectionConfig | None) -> Any:
        rows = obstacle_distances(voxel_map, self._distances, band)
        return encode_cloud_fields(self._types, stamp, self._frame, DISTANCE_FIELDS, rows)

    def _octomap(self, voxel_map: VoxelMap, stamp: int, *, binary: bool) -> Any:
        tree = (binary_tree if binary else full_tree)(voxel_map)
        size = voxel_map.config.voxel_size
        return encode_octomap(self._types, stamp, self._frame, size, tree.data, binary=binary)
