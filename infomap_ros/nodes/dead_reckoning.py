"""Node ``dead_reckoning``: camera_pose from odometry, joint states and the robot's description.

For robots that have no better localization. There is one pose for every message on
left/camera_info, with its stamp; the map is where odometry began. The pose drifts, and its
covariance grows with it.
"""

from __future__ import annotations

from functools import partial
from typing import Any

from geometry_msgs.msg import PoseWithCovarianceStamped
from sensor_msgs.msg import CameraInfo

from infomap_ros.errors import PoseUnavailableError
from infomap_ros.geometry import OdometryRecord, PoseRecord, TransformRecord, invert_transform
from infomap_ros.geometry.pose_buffer import PoseBuffer, PoseBufferConfig
from infomap_ros.geometry.records import WaitingQueue, WaitingQueueConfig
from infomap_ros.localization.dead_reckoning import DeadReckoning, DeadReckoningConfig, user_base
from infomap_ros.messages import decode_camera_info, encode_pose
from infomap_ros.nodes.common import qos
from infomap_ros.nodes.common.base import MonitoredNode
from infomap_ros.nodes.common.message_types import RclpyMessageTypes
from infomap_ros.nodes.common.run import run_node
from infomap_ros.nodes.locating.base_topics import (
    INITIAL_POSE,
    BaseOdometry,
    MapFrameConfig,
    OdomFrameBroadcaster,
    frame_publisher,
    listen_to_initial_pose,
)
from infomap_ros.nodes.robot.posture_listener import PostureListener
from infomap_ros.nodes.robot.robot_tracker import RobotTrackerConfig


class DeadReckoningNode(MonitoredNode):
    """See the module."""

    CONFIGS = (
        (RobotTrackerConfig, ""),
        (MapFrameConfig, ""),
        (DeadReckoningConfig, "motion_noise."),
        (PoseBufferConfig, "poses."),
        (WaitingQueueConfig, "waiting."),
    )

    def __init__(self, **node_arguments: Any) -> None:
        super().__init__("dead_reckoning", **node_arguments)
        self._frames, self._types = self.config(RobotTrackerConfig), RclpyMessageTypes()
        self._reckoning = DeadReckoning(self.config(DeadReckoningConfig))
        self._bases = PoseBuffer(self.config(PoseBufferConfig))
        self._waiting: WaitingQueue[str] = WaitingQueue(
            self._bases_at,
            self.config(WaitingQueueConfig),
            lambda _, __, why: self.drop("no odometry or joints at the stamp", why),
        )
        self._poses = self.advertise(PoseWithCovarianceStamped, "camera_pose", qos.stream(depth=50))
        tolerance = self.config(MapFrameConfig).transform_tolerance
        self._odom_frame = OdomFrameBroadcaster(self, frame_publisher(self), tolerance)
        self._motion = PostureListener(
            self, self._answer, required=True, on_odometry=self._on_odometry
        )
        self._base_odometry = BaseOdometry(self)
        listen_to_initial_pose(self, self._place)
        self.listen(CameraInfo, "left/camera_info", self._on_info, qos.sensor_data())

    def _on_odometry(self, odometry: OdometryRecord) -> None:
        if self._bases.add(self._reckoning.add(odometry)):
            self.get_logger().warning("time went backwards: the map is where odometry begins now")
            self._reckoning = DeadReckoning(self.config(DeadReckoningConfig))
            self._bases.add(self._reckoning.add(odometry))

    def _place(self, given: PoseRecord) -> None:
        """The base is where a user says; poses from before are forgotten, not joined to it."""
        stamp = self._bases.newest_stamp
        if stamp is None:
            raise PoseUnavailableError("there was no odometry yet", "no odometry")
        self._reckoning.place(user_base(given, self._bases.at(stamp).transform))
        self._bases.clear()
        self.get_logger().info(f"{INITIAL_POSE}: the map's frame is where that puts it")

    def _on_info(self, message: CameraInfo) -> None:
        record = decode_camera_info(message)
        frame = self._frames.camera_frame or record.frame_id
        self._motion.look_from(frame)
        self._waiting.push(record.stamp, frame)
        self._answer()

    def _bases_at(self, stamp: int) -> PoseRecord:
        """The base at a stamp, once it is known where the camera is on it too."""
        self._motion.posture(stamp)
        return self._bases.at(stamp)

    def _answer(self) -> None:
        if not self._motion.is_known:
            return
        for frame, base in self._waiting.take():
            self.guard("camera_pose", partial(self._publish, frame, base))

    def _publish(self, frame: str, base: PoseRecord) -> None:
        posture = self._motion.posture(base.stamp)
        pose = self._reckoning.camera_pose(base, posture.T_base_camera, frame)
        pose = PoseRecord(pose.stamp, self._frames.map_frame, pose.transform, pose.covariance)
        self._poses.publish(encode_pose(self._types, pose))
        T_map_odom = base.transform @ invert_transform(posture.T_odom_base)
        names = self._frames.map_frame, self._motion.odom_frame
        self._odom_frame.update(TransformRecord(base.stamp, *names, T_map_odom))
        self._base_odometry.publish(pose, posture.T_base_camera)
        self.health.produced()


def main() -> int:
    """Run the node."""
    return run_node(DeadReckoningNode)


if __name__ == "__main__":
    raise SystemExit(main())
