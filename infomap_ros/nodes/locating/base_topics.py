"""The base of the robot in the map: base_odometry out, initialpose in."""

from __future__ import annotations

from collections.abc import Callable

from geometry_msgs.msg import PoseWithCovarianceStamped
from nav_msgs.msg import Odometry

from infomap_ros.errors import FrameError
from infomap_ros.geometry import PoseRecord
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.localization.dead_reckoning import DeadReckoningConfig, base_in_map
from infomap_ros.messages import decode_pose_with_covariance
from infomap_ros.messages.encode import encode_odometry
from infomap_ros.nodes.common import qos
from infomap_ros.nodes.common.base import MonitoredNode
from infomap_ros.nodes.common.message_types import RclpyMessageTypes
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
        told = decode_pose_with_covariance(message)
        if told.frame_id != frame:
            raise FrameError(f"{INITIAL_POSE} in frame '{told.frame_id}', the map is '{frame}'")
        place(told)

    node.listen(PoseWithCovarianceStamped, INITIAL_POSE, receive, qos.stream(), required=False)
