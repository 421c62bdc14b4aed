"""The base of the robot in the map: base_odometry and tf out, initialpose in.

tf refuses a transform that is newer than the newest that it has. An image is old when its
pose is known, and the next pose comes a period later; so the transform from the map to the frame of
odometry (REP-105) is stamped ahead by a tolerance and sent again, with a later stamp, until there
is a newer one. It is nearly constant: odometry does the moving in between.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import dataclass, replace

from geometry_msgs.msg import PoseWithCovarianceStamped
from nav_msgs.msg import Odometry

from infomap_ros.errors import FrameError
from infomap_ros.geometry import PoseRecord, TransformRecord
from infomap_ros.geometry.config import check_config, parameter
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.localization.dead_reckoning import DeadReckoningConfig, base_in_map
from infomap_ros.messages import TF, decode_pose_with_covariance, encode_transforms
from infomap_ros.messages.encode import encode_odometry
from infomap_ros.nodes.common import qos
from infomap_ros.nodes.common.base import MonitoredNode
from infomap_ros.nodes.common.message_types import RclpyMessageTypes, message_class
from infomap_ros.nodes.robot.robot_tracker import RobotTrackerConfig

INITIAL_POSE = "initialpose"  # as RViz and AMCL call it


class BaseOdometry:
    """Publishes where the base is, for robot_localization and others that filter poses of it.

    Args:
        node: that publishes; has the configurations of frames and of how well it knows the robot.
    """

    def __init__(self, node: MonitoredNode) -> None:
        self._types, self._config = RclpyMessageTypes(), node.config(DeadReckoningConfig)
        self._base_frame = node.config(RobotTrackerConfig).base_frame
        self._publisher = node.advertise(Odometry, "base_odometry", qos.stream(depth=50))

    def publish(self, camera: PoseRecord, T_base_camera: FloatArray) -> None:
        """Publish, if anybody subscribes.

        Args:
            camera: pose of the camera in the map.
            T_base_camera: shape (4, 4).
        """
        if self._publisher.get_subscription_count():
            base = base_in_map(camera, T_base_camera, self._base_frame, self._config)
            self._publisher.publish(encode_odometry(self._types, base))


def listen_to_initial_pose(node: MonitoredNode, place: Callable[[PoseRecord], object]) -> None:
    """Take initialpose.

    Args:
        node: that listens; has the configuration of frames.
        place: given the pose of the base in the map.
    """
    frame = node.config(RobotTrackerConfig).map_frame

    def receive(message: PoseWithCovarianceStamped) -> None:
        given = decode_pose_with_covariance(message)
        if given.frame_id != frame:
            raise FrameError(f"{INITIAL_POSE} in frame '{given.frame_id}', the map is '{frame}'")
        place(given)

    node.listen(PoseWithCovarianceStamped, INITIAL_POSE, receive, qos.stream(), required=False)


PERIOD = 0.05
"""Between two publications [s]: controllers and costmaps of Nav2 look up at 5 to 20 Hz."""


_LATE = 1_000_000_000
"""By how much the stamp of a pose may be behind what was sent [ns]: more is a clock that jumped."""


@dataclass(frozen=True)
class MapFrameConfig:
    """How the map's place in tf is published.

    Raises:
        ConfigError: a value is out of its range.
    """

    publish_tf: bool = parameter(
        True,
        "Publish /tf: map to the frame of odometry, or where there is no odometry to the topmost "
        "frame above the camera.",
    )
    transform_tolerance: float = parameter(
        0.5,
        "The transform from map to odometry, published at 20 Hz, is stamped so far ahead of its "
        "image: longer than from an image to its pose, so that users of tf need not wait.",
        unit="s",
        low=0.0,
        high=10.0,
    )

    def __post_init__(self) -> None:
        check_config(self)


def frame_publisher(node: MonitoredNode) -> Callable[[TransformRecord], None]:
    """What publishes a transform on /tf; nothing where that is not wanted or has no messages.

    Args:
        node: has a `MapFrameConfig`.
    """
    if not node.config(MapFrameConfig).publish_tf:
        return lambda _: None
    try:
        publisher = node.advertise(message_class(TF), "/tf", qos.stream(depth=100))
    except ModuleNotFoundError:
        node.get_logger().warning("no /tf: tf2_msgs is not installed")
        return lambda _: None
    types = RclpyMessageTypes()
    return lambda edge: publisher.publish(encode_transforms(types, [edge]))


class OdomFrameBroadcaster:
    """Publishes the newest transform again and again. May be used by any thread.

    Between poses, time goes on by the node's clock; where that stands (a simulator or bag that is
    paused) or jumps back, nothing is repeated.

    Args:
        node: whose clock and timer are used.
        publish: sends one transform.
        tolerance: how far a stamp is ahead of its time [s].
    """

    def __init__(
        self, node: MonitoredNode, publish: Callable[[TransformRecord], None], tolerance: float
    ) -> None:
        self._node, self._publish, self._ahead = node, publish, round(1e9 * tolerance)
        self._lock = threading.Lock()
        self._edge: TransformRecord | None = None
        self._begin = self._sent = 0  # [ns]
        node.repeat(PERIOD, self._repeat)

    def update(self, edge: TransformRecord) -> None:
        """Publish a transform, and from now on this one.

        Args:
            edge: the map to odometry, at the stamp of its image.
        """
        with self._lock:
            self._edge, self._begin = edge, self._now()
            stamp = edge.stamp + self._ahead
            if not 0 <= self._sent - stamp < _LATE:  # else it is sent as soon as time has gone on
                self._send(stamp)

    def _repeat(self) -> None:
        with self._lock:
            if self._edge is None:
                return
            stamp = self._edge.stamp + self._ahead + self._now() - self._begin
            if stamp > self._sent:
                self._send(stamp)

    def _send(self, stamp: int) -> None:
        if self._edge is not None:
            self._sent = stamp
            self._publish(replace(self._edge, stamp=stamp))

    def _now(self) -> int:
        return int(self._node.get_clock().now().nanoseconds)
