"""traversability_map: where the base can stand, on a topic and by service."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from nav_msgs.msg import OccupancyGrid
from nav_msgs.srv import GetMap

from infomap_ros.mapping.files.projection import ProjectedGrid
from infomap_ros.messages import encode_occupancy_grid
from infomap_ros.nodes.common import qos
from infomap_ros.nodes.common.base import MonitoredNode
from infomap_ros.nodes.common.message_types import RclpyMessageTypes
from infomap_ros.nodes.common.orders import offer_service
from infomap_ros.nodes.common.worker import Worker
from infomap_ros.nodes.robot.robot_tracker import RobotTrackerConfig

_NAME = "traversability_map"


class TraversabilityMap:
    """Makes the grid when it is asked for, and for subscribers when `publish` is called.

    Args:
        node: that publishes; has the configuration of frames.
        worker: whose thread makes it.
        make: the grid as it is now.
    """

    def __init__(
        self, node: MonitoredNode, worker: Worker, make: Callable[[], ProjectedGrid]
    ) -> None:
        self._node, self._worker, self._make = node, worker, make
        self._types = RclpyMessageTypes()
        self._frame = node.config(RobotTrackerConfig).map_frame
        show = self._on_subscriber
        self._publisher = node.advertise(OccupancyGrid, _NAME, qos.current(), show)
        offer_service(node, GetMap, _NAME, worker, self._give)

    def publish(self) -> None:
        """Publish to who subscribes; called by the worker."""
        if self._publisher.get_subscription_count():
            self._node.guard(_NAME, lambda: self._publisher.publish(self._message()))

    def _on_subscriber(self) -> None:
        self._worker.submit_always(self.publish)

    def _give(self, _: Any, response: Any) -> None:
        response.map = self._message()

    def _message(self) -> Any:
        grid, stamp = self._make(), self._node.get_clock().now().nanoseconds
        return encode_occupancy_grid(
            self._types, stamp, self._frame, grid.cells, grid.resolution, grid.origin
        )
