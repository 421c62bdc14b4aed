"""What map_fusion publishes of its map. Nothing is built that nobody subscribes to."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from nav_msgs.msg import OccupancyGrid
from numpy.typing import NDArray
from sensor_msgs.msg import PointCloud2

from infomap_ros.geometry.config import check_config, parameter
from infomap_ros.mapping import LOG_ODDS_QUANTUM, SHARED_LOG_ODDS_LIMIT, VoxelChanges, VoxelMap
from infomap_ros.nodes import qos
from infomap_ros.nodes.base import MonitoredNode
from infomap_ros.nodes.message_types import RclpyMessageTypes
from infomap_ros.replay.messages import encode_cloud_fields, encode_occupancy_grid
from infomap_ros.replay.messages.rows import encode_rows
from infomap_ros.team import MapUpdate, encode_update

_VOXEL_MAP_FIELDS = ("x", "y", "z", "probability", "sigma")


@dataclass(frozen=True)
class MapOutputsConfig:
    """What map_fusion publishes.

    Raises:
        ConfigError: a value is out of its range.
    """

    map_frame: str = parameter("map", "Frame of the map; camera_pose must be given in it.")
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
    projection_low: float = parameter(
        0.1, "Lower end of the height band of projected_map.", unit="m", low=-1e4, high=1e4
    )
    projection_high: float = parameter(
        1.0, "Upper end of the height band of projected_map.", unit="m", low=-1e4, high=1e4
    )

    def __post_init__(self) -> None:
        check_config(self)


class MapOutputs:
    """The publishers of a map.

    Args:
        node: the node that publishes.
        config: what and how often.
    """

    def __init__(self, node: MonitoredNode, config: MapOutputsConfig) -> None:
        self._config = config
        self._types = RclpyMessageTypes()
        self._version = 0
        self._updates = node.advertise(PointCloud2, "map_updates", qos.stream(depth=50))
        self._voxel_map = node.advertise(PointCloud2, "voxel_map", qos.latched())
        self._projected = node.advertise(OccupancyGrid, "projected_map", qos.latched())

    def publish_changes(self, voxel_map: VoxelMap, stamp: int) -> None:
        """Send the voxels that changed since the last call; always, as each is sent but once."""
        changes = voxel_map.take_changes()
        self._publish_update(changes, voxel_map.config.voxel_size, stamp)

    def publish_all(self, voxel_map: VoxelMap, stamp: int) -> None:
        """Send every voxel, for example after a map was loaded."""
        self._publish_update(whole_map(voxel_map), voxel_map.config.voxel_size, stamp)

    def publish_removal(self, voxel_map: VoxelMap, stamp: int) -> None:
        """Take everything back: every voxel of the map goes out as one without evidence."""
        indices, _ = voxel_map.voxels()
        self._publish_update(_without_evidence(indices), voxel_map.config.voxel_size, stamp)

    def publish_pictures(self, voxel_map: VoxelMap, stamp: int) -> None:
        """Send voxel_map and projected_map to whom is there; late ones get the last of them."""
        if self._voxel_map.get_subscription_count():
            self._voxel_map.publish(
                encode_cloud_fields(
                    self._types, stamp, self._config.map_frame, _VOXEL_MAP_FIELDS,
                    voxel_map_rows(voxel_map),
                )
            )  # fmt: skip
        if self._projected.get_subscription_count():
            self._projected.publish(self._project(voxel_map, stamp))

    def _project(self, voxel_map: VoxelMap, stamp: int) -> OccupancyGrid:
        low, high = self._config.projection_low, self._config.projection_high
        cells, origin = projected_cells(voxel_map, low, high)
        size = voxel_map.config.voxel_size
        frame = self._config.map_frame
        return encode_occupancy_grid(self._types, stamp, frame, cells, size, origin)

    def _publish_update(self, changes: VoxelChanges, voxel_size: float, stamp: int) -> None:
        self._version += 1
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
        for rows in encode_update(update):
            message = encode_rows(self._types, stamp, self._config.map_frame, rows)
            self._updates.publish(message)


def whole_map(voxel_map: VoxelMap) -> VoxelChanges:
    """Every known voxel of a map, as `VoxelMap.take_changes` would tell it."""
    indices, log_odds = voxel_map.voxels()
    quanta = np.rint(log_odds / LOG_ODDS_QUANTUM)
    quanta = np.clip(quanta, -SHARED_LOG_ODDS_LIMIT, SHARED_LOG_ODDS_LIMIT).astype(np.int8)
    changes = _without_evidence(indices)
    changes.log_odds[:] = quanta
    surface, means, covariances = voxel_map.gaussians()
    rows = _find_rows(indices, surface)
    changes.has_gaussian[rows] = True
    changes.means[rows], changes.covariances[rows] = means, covariances
    return changes


def voxel_map_rows(voxel_map: VoxelMap) -> NDArray[np.float32]:
    """Surface voxels as rows (x, y, z, probability, sigma), shape (K, 5).

    Position is the mean of the Gaussian [m, map]; sigma is the standard deviation of the surface
    along its normal, the smallest of the Gaussian [m].
    """
    _, means, covariances = voxel_map.gaussians()
    rows = np.empty((len(means), len(_VOXEL_MAP_FIELDS)), dtype=np.float32)
    rows[:, :3] = means
    rows[:, 3] = voxel_map.probability(means) if len(means) else 0.0
    rows[:, 4] = np.sqrt(np.linalg.eigvalsh(covariances)[:, 0]) if len(means) else 0.0
    return rows


def projected_cells(
    voxel_map: VoxelMap, low: float, high: float
) -> tuple[NDArray[np.int8], tuple[float, float]]:
    """The map between two heights, seen from above.

    Args:
        voxel_map: the map.
        low: voxels with their centre from here [m] ...
        high: ... to here [m] count.

    Returns:
        Cells, shape (rows along y, columns along x): -1 where nothing is known, else the highest
        occupancy probability of the column in percent; and x, y of the corner of cell (0, 0) [m].
    """
    size = voxel_map.config.voxel_size
    indices, log_odds = voxel_map.voxels()
    heights = (indices[:, 2] + 0.5) * size
    chosen = (heights >= low) & (heights <= high)
    columns, evidence = indices[chosen, :2], log_odds[chosen].astype(np.float64)
    if not len(columns):
        return np.full((1, 1), -1, dtype=np.int8), (0.0, 0.0)
    first = columns.min(axis=0)
    width, depth = columns.max(axis=0) - first + 1
    percent = np.rint(100.0 / (1.0 + np.exp(-np.clip(evidence, -50.0, 50.0)))).astype(np.int8)
    cells = np.full((depth, width), -1, dtype=np.int8)
    x, y = (columns - first).T
    np.maximum.at(cells, (y, x), percent)
    return cells, (float(first[0] * size), float(first[1] * size))


def _without_evidence(indices: NDArray[np.int32]) -> VoxelChanges:
    count = len(indices)
    return VoxelChanges(
        indices,
        np.zeros(count, np.int8),
        np.zeros(count, np.bool_),
        np.full((count, 3), np.nan),
        np.full((count, 3, 3), np.nan),
    )


def _find_rows(indices: NDArray[np.int32], wanted: NDArray[np.int32]) -> NDArray[np.intp]:
    """Rows of `indices` that hold the `wanted` voxels."""
    keys, targets = (_packed(values) for values in (indices, wanted))
    order = np.argsort(keys)
    return order[np.searchsorted(keys, targets, sorter=order)]


def _packed(indices: NDArray[np.int32]) -> NDArray[np.int64]:
    shifted = indices.astype(np.int64) + 2**20
    return np.asarray((shifted[:, 0] << 42) | (shifted[:, 1] << 21) | shifted[:, 2])
