"""The services by which others ask map_fusion for its map, or take a part out of it."""

from __future__ import annotations

from functools import partial
from typing import Any

from nav_msgs.srv import GetMap

from infomap_ros.nodes.common.base import MonitoredNode
from infomap_ros.nodes.common.message_types import message_class
from infomap_ros.nodes.common.orders import offer_service
from infomap_ros.nodes.common.worker import Worker
from infomap_ros.nodes.fusion.map_keeper import MapKeeper
from infomap_ros.nodes.fusion.map_outputs import OCTOMAP_BINARY, OCTOMAP_FULL, PROJECTED_MAP


def offer_map(node: MonitoredNode, keeper: MapKeeper, worker: Worker) -> None:
    """Offer the services; those of octomap_msgs where that is installed.

    Args:
        node: that offers them.
        keeper: of the map.
        worker: whose thread owns the map.
    """

    def give(topic: str, _: Any, response: Any) -> None:
        response.map = keeper.picture(topic)

    def clear(request: Any, _: Any) -> None:
        corners = ((corner.x, corner.y, corner.z) for corner in (request.min, request.max))
        node.get_logger().info(keeper.clear_region(*corners))

    offer_service(node, GetMap, PROJECTED_MAP, worker, partial(give, PROJECTED_MAP))
    if not keeper.has_octomap:
        return
    for topic in (OCTOMAP_BINARY, OCTOMAP_FULL):
        kind = message_class("octomap_msgs/srv/GetOctomap")
        offer_service(node, kind, topic, worker, partial(give, topic))
    query = message_class("octomap_msgs/srv/BoundingBoxQuery")
    offer_service(node, query, "~/clear_region", worker, clear)
