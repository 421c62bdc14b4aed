"""Odometry of the base, from its topic or from tf."""

from __future__ import annotations

from collections.abc import Callable

from nav_msgs.msg import Odometry

from infomap_ros.errors import FrameError, PoseUnavailableError
from infomap_ros.geometry import OdometryRecord, TransformRecord
from infomap_ros.geometry.transform_tree import TransformTree
from infomap_ros.messages import decode_odometry
from infomap_ros.nodes.common import qos
from infomap_ros.nodes.common.base import MonitoredNode
from infomap_ros.nodes.robot.frame_listener import FrameListener


class OdometryFromFrames:
    """Puts the place of the base in the frame of odometry together, edge by edge.

    Args:
        odom_frame: the frame of odometry.
        base_frame: of the robot, anywhere below that.
    """

    def __init__(self, odom_frame: str, base_frame: str) -> None:
        self._odom, self._base = odom_frame, base_frame
        self._tree = TransformTree()
        self._told = -1

    def add(self, edge: TransformRecord) -> OdometryRecord | None:
        """Take a transform.

        Returns:
            The base in the frame of odometry at its stamp, with unknown covariance; None where it
            does not tell, or was told already.

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
        if edge.stamp == self._told:
            return None
        self._told = edge.stamp
        return OdometryRecord(edge.stamp, self._odom, pose.transform, None, self._base)


_LOOK_PERIOD = 1.0  # [s]


class OdometryListener:
    """Listens to odom. While nobody publishes that, the frames of tf tell where the base is.

    Args:
        node: that listens.
        on_odometry: told of each record.
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
            self._frames.hear_moving()

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
