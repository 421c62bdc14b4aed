"""Odometry of the base, from its topic or from tf.

Transforms of /tf and /tf_static.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable
from functools import partial
from typing import Any

from nav_msgs.msg import Odometry
from rclpy.qos import QoSProfile
from rclpy.subscription import Subscription

from infomap_ros.errors import FrameError, MalformedMessageError, PoseUnavailableError
from infomap_ros.geometry import OdometryRecord, TransformRecord
from infomap_ros.geometry.pose_buffer import MOST_FRAMES, TransformTree
from infomap_ros.messages import TF, decode_odometry, decode_transforms
from infomap_ros.nodes.common import qos
from infomap_ros.nodes.common.base import MonitoredNode
from infomap_ros.nodes.common.message_types import message_class

_MOST_AT_ONCE = 1000  # of one message


class FrameListener:
    """Listens to /tf_static, and to /tf from when that is needed.

    Without tf2_msgs nothing is received, and the log says so.

    Args:
        node: that listens.
        on_edge: called with each transform.
    """

    def __init__(self, node: MonitoredNode, on_edge: Callable[[TransformRecord], None]) -> None:
        self._node, self._on_edge = node, on_edge
        self.static: OrderedDict[str, TransformRecord] = OrderedDict()  # by child, newest last
        self._moving: Subscription | None = None
        self._listen("/tf_static", qos.latched(depth=100), is_static=True)

    def listen_to_moving(self) -> None:
        """Listen to /tf too from now on: of busy robots that is a thousand messages a second."""
        if self._moving is None:
            self._moving = self._listen("/tf", qos.stream(depth=100), is_static=False)

    def ignore_moving(self) -> None:
        """Listen to /tf no longer."""
        if self._moving is not None:
            topic = self._moving.topic_name
            self._node.destroy_subscription(self._moving)
            if self._node.lockstep is not None:
                self._node.lockstep.ceases(topic)
            self._moving = None

    def _listen(self, topic: str, profile: QoSProfile, *, is_static: bool) -> Subscription | None:
        try:
            kind = message_class(TF)
        except ModuleNotFoundError:
            self._node.get_logger().warning(f"{topic} is not read: tf2_msgs is not installed")
            return None
        receive = partial(self._on_transforms, is_static=is_static)
        return self._node.listen(kind, topic, receive, profile, required=False)

    def _on_transforms(self, message: Any, *, is_static: bool) -> None:
        edges = decode_transforms(message, is_static)
        if len(edges) > _MOST_AT_ONCE:
            text = f"has {len(edges)} transforms, at most {_MOST_AT_ONCE} are taken at once"
            raise MalformedMessageError(TF, text)
        for edge in edges:
            if edge.is_static:
                self.static[edge.child_frame_id] = edge
                self.use(edge.child_frame_id)
            self._on_edge(edge)

    def use(self, child: str) -> None:
        """Note that the fixed transform of a frame is of use: that of the longest unused goes."""
        if child in self.static:
            self.static.move_to_end(child)
        if len(self.static) > MOST_FRAMES:
            self.static.popitem(last=False)


class OdometryFromFrames:
    """Puts the place of the base in the frame of odometry together, edge by edge.

    Args:
        odom_frame: the frame of odometry.
        base_frame: of the robot, anywhere below that.
    """

    def __init__(self, odom_frame: str, base_frame: str) -> None:
        self._odom, self._base = odom_frame, base_frame
        self._tree = TransformTree()
        self._newest = -1

    def add(self, edge: TransformRecord) -> OdometryRecord | None:
        """Take a transform.

        Returns:
            The base in the frame of odometry at its stamp, with unknown covariance; None where it
            does not say, or was returned already.

        Raises:
            FrameError: the edge's child moves and has had another parent.
        """
        self._tree.add_transform(edge)
        if edge.is_static:
            return None
        try:
            pose = self._tree.at(self._odom, self._base, edge.stamp)
        except (PoseUnavailableError, FrameError):
            return None  # not there yet, or another branch of the tree
        if edge.stamp == self._newest:
            return None
        self._newest = edge.stamp
        return OdometryRecord(edge.stamp, self._odom, pose.transform, None, self._base)


_LOOK_PERIOD = 1.0  # [s]


class OdometryListener:
    """Listens to odom. While nobody publishes that, the frames of tf say where the base is.

    Args:
        node: that listens.
        on_odometry: called with each record.
        frames: of the robot.
        odom_frame: frame of odometry on tf.
        base_frame: whose pose it is; empty for any.
        required: whether the node cannot work without it.
    """

    def __init__(
        self,
        node: MonitoredNode,
        on_odometry: Callable[[OdometryRecord], None],
        frames: FrameListener,
        odom_frame: str,
        base_frame: str,
        *,
        required: bool,
    ) -> None:
        self._node, self._on_odometry, self._frames = node, on_odometry, frames
        self._base, self._topic = base_frame, node.resolve_topic_name("odom")
        self._by_frames = OdometryFromFrames(odom_frame, base_frame)
        self._has_come = self._is_on_tf = False
        profile = qos.sensor_data(100)
        node.listen(Odometry, "odom", self._on_message, profile, required=required)
        node.repeat(_LOOK_PERIOD, self._look)

    @property
    def is_offered(self) -> bool:
        """Whether somebody publishes odometry, on its topic or on tf."""
        return self._is_on_tf or self._node.count_publishers(self._topic) > 0

    def add(self, edge: TransformRecord) -> None:
        """Take a transform of tf.

        Raises:
            FrameError: its child moves and has had another parent.
        """
        if self._has_come or not self._base:
            return
        record = self._by_frames.add(edge)
        if record is not None:
            if not self._is_on_tf:
                self._is_on_tf = True
                self._node.get_logger().info("odometry from /tf, as nobody publishes odom")
            self._node.health.arrived(self._topic)
            self._on_odometry(record)

    def _look(self) -> None:
        if not self._has_come and not self._node.count_publishers(self._topic):
            self._frames.listen_to_moving()

    def _on_message(self, message: Odometry) -> None:
        odometry: OdometryRecord = decode_odometry(message)
        if self._base and odometry.child_frame_id != self._base:
            raise FrameError(
                f"odometry of '{odometry.child_frame_id}', base_frame is '{self._base}'"
            )
        if self._is_on_tf and not self._has_come:
            self._node.get_logger().info("odometry from odom, no longer from /tf")
        self._has_come, self._is_on_tf = True, False
        self._on_odometry(odometry)
