"""The box that a user has placed on a page, as a marker on interest."""

from __future__ import annotations

from visualization_msgs.msg import Marker, MarkerArray

from infomap_ros.nodes.common import qos
from infomap_ros.nodes.common.base import MonitoredNode
from infomap_ros.viewer.interest_box import InterestBox

_NAMESPACE = "web_viewer"


class InterestPublisher:
    """Publishes the box, or that it is gone.

    Args:
        node: that publishes.
        map_frame: in which the box is.
    """

    def __init__(self, node: MonitoredNode, map_frame: str) -> None:
        self._node, self._map_frame = node, map_frame
        self._publisher = node.advertise(MarkerArray, "interest", qos.latched())

    def publish(self, box: InterestBox | None) -> None:
        """Publish the box; None takes the last one away."""
        marker = Marker(ns=_NAMESPACE, id=0, type=Marker.CUBE)
        marker.header.frame_id = self._map_frame
        marker.header.stamp = self._node.get_clock().now().to_msg()
        marker.action = Marker.DELETE if box is None else Marker.ADD
        if box is not None:
            position, scale, color = marker.pose.position, marker.scale, marker.color
            position.x, position.y, position.z = box.center
            scale.x, scale.y, scale.z = box.size
            color.r, color.g, color.b, color.a = 0.8, 0.47, 0.65, 0.3
            marker.pose.orientation.w = 1.0
            marker.text = f"{box.weight:g}"
        self._publisher.publish(MarkerArray(markers=[marker]))
