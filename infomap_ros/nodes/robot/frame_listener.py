"""Transforms of /tf and /tf_static."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable
from functools import partial
from typing import Any

from rclpy.qos import QoSProfile
from rclpy.subscription import Subscription

from infomap_ros.errors import MalformedMessageError
from infomap_ros.geometry import TransformRecord
from infomap_ros.messages import TF, decode_transforms
from infomap_ros.nodes.common import qos
from infomap_ros.nodes.common.base import MonitoredNode
from infomap_ros.nodes.common.message_types import message_class

_MOST_FRAMES = 10_000  # that are known; a robot has some hundreds
_MOST_AT_ONCE = 1000  # of one message


class FrameListener:
    """Listens to /tf_static, and to /tf from when that is needed.

    Without tf2_msgs nothing is heard, and the log says so.

    Args:
        node: that listens.
        on_edge: told of each transform.
    """

    def __init__(self, node: MonitoredNode, on_edge: Callable[[TransformRecord], None]) -> None:
        self._node, self._on_edge = node, on_edge
        self.static: OrderedDict[str, TransformRecord] = OrderedDict()  # by child, newest last
        self._moving: Subscription | None = None
        self._listen("/tf_static", qos.latched(depth=100), is_static=True)

    def hear_moving(self) -> None:
        """Listen to /tf too from now on: of busy robots that is a thousand messages a second."""
        if self._moving is None:
            self._moving = self._listen("/tf", qos.stream(depth=100), is_static=False)

    def ignore_moving(self) -> None:
        """Listen to /tf no longer."""
        if self._moving is not None:
            self._node.destroy_subscription(self._moving)
            self._moving = None

    def _listen(self, topic: str, profile: QoSProfile, *, is_static: bool) -> Subscription | None:
        try:
            kind = message_class(TF)
        except ModuleNotFoundError:
            self._node.get_logger().warning(f"{topic} is not heard: tf2_msgs is not installed")
            return None
        receive = partial(self._on_transforms, is_static=is_static)
        return self._node.listen(kind, topic, receive, profile, required=False)

    def _on_transforms(self, message: Any, *, is_static: bool) -> None:
        edges = decode_transforms(message, is_static)
        if len(edges) > _MOST_AT_ONCE:
            text = f"has {len(edges)} transforms, at most {_MOST_AT_ONCE} are heard at once"
            raise MalformedMessageError(TF, text)
        for edge in edges:
            if edge.is_static:
                self.keep(edge)
            self._on_edge(edge)

    def keep(self, edge: TransformRecord) -> None:
        """Note that a fixed transform was told, or is used."""
        self.static[edge.child_frame_id] = edge
        self.static.move_to_end(edge.child_frame_id)
        if len(self.static) > _MOST_FRAMES:
            self.static.popitem(last=False)
