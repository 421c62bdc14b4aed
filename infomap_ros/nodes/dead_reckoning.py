"""Node ``dead_reckoning``: camera_pose from odometry, joint states and the robot's description.

For robots that have no better localisation. There is one pose for every message on
left/camera_info, with its stamp; the map is where odometry began. The pose drifts, and its
covariance grows with it.
"""

from __future__ import annotations

from functools import partial
from typing import Any

from geometry_msgs.msg import PoseWithCovarianceStamped
from nav_msgs.msg import Odometry
from sensor_msgs.msg import CameraInfo, JointState
from std_msgs.msg import String

from infomap_ros.errors import FrameError
from infomap_ros.geometry import PoseRecord
from infomap_ros.geometry.joint_buffer import JointBuffer, JointBufferConfig
from infomap_ros.geometry.pose_buffer import PoseBuffer, PoseBufferConfig
from infomap_ros.geometry.waiting_queue import WaitingQueue, WaitingQueueConfig
from infomap_ros.localization import DeadReckoning, DeadReckoningConfig
from infomap_ros.messages import (
    decode_camera_info,
    decode_joint_state,
    decode_odometry,
    decode_text,
    encode_pose,
)
from infomap_ros.motion import RobotModel
from infomap_ros.nodes.common import qos
from infomap_ros.nodes.common.base import MonitoredNode
from infomap_ros.nodes.common.message_types import RclpyMessageTypes
from infomap_ros.nodes.common.run import run_node
from infomap_ros.nodes.robot.robot_tracker import RobotTrackerConfig


class DeadReckoningNode(MonitoredNode):
    """See the module."""

    CONFIGS = (
        (RobotTrackerConfig, ""),
        (DeadReckoningConfig, ""),
        (PoseBufferConfig, "poses."),
        (JointBufferConfig, "joints."),
        (WaitingQueueConfig, "waiting."),
    )

    def __init__(self, **node_arguments: Any) -> None:
        super().__init__("dead_reckoning", **node_arguments)
        self._frames, self._types = self.config(RobotTrackerConfig), RclpyMessageTypes()
        self._reckoning = DeadReckoning(self.config(DeadReckoningConfig))
        self._bases = PoseBuffer(self.config(PoseBufferConfig))
        self._joints = JointBuffer(self.config(JointBufferConfig))
        self._robot: RobotModel | None = None
        self._waiting: WaitingQueue[str] = WaitingQueue(
            self._bases_at,
            self.config(WaitingQueueConfig),
            lambda _, __, why: self.drop("no odometry or joints at the stamp", why),
        )
        self._poses = self.advertise(PoseWithCovarianceStamped, "camera_pose", qos.stream(depth=50))
        self.listen(String, "robot_description", self._on_description, qos.latched())
        self.listen(JointState, "joint_states", self._on_joints, qos.sensor_data(100))
        self.listen(Odometry, "odom", self._on_odometry, qos.sensor_data(100))
        self.listen(CameraInfo, "left/camera_info", self._on_info, qos.sensor_data())

    def _on_description(self, message: String) -> None:
        text = decode_text(message).text
        self._robot = self._frames.robot.read(text, base_frame=self._frames.base_frame)

    def _on_joints(self, message: JointState) -> None:
        self._joints.add(decode_joint_state(message))
        self._answer()

    def _on_odometry(self, message: Odometry) -> None:
        odometry, wanted = decode_odometry(message), self._frames.base_frame
        if wanted and odometry.child_frame_id != wanted:
            raise FrameError(f"odometry of '{odometry.child_frame_id}', base_frame is '{wanted}'")
        if self._bases.add(self._reckoning.add(odometry)):
            self.get_logger().warning("time went backwards: the map is where odometry begins now")
            self._reckoning = DeadReckoning(self.config(DeadReckoningConfig))
            self._bases.add(self._reckoning.add(odometry))
        self._answer()

    def _on_info(self, message: CameraInfo) -> None:
        record = decode_camera_info(message)
        self._waiting.push(record.stamp, self._frames.camera_frame or record.frame_id)
        self._answer()

    def _bases_at(self, stamp: int) -> PoseRecord:
        """The base at a stamp, once the joints are known too."""
        if self._robot is not None and self._robot.joints:
            self._joints.at(stamp)
        return self._bases.at(stamp)

    def _answer(self) -> None:
        if self._robot is None:
            return
        for frame, base in self._waiting.take():
            self.guard("camera_pose", partial(self._publish, self._robot, frame, base))

    def _publish(self, robot: RobotModel, frame: str, base: PoseRecord) -> None:
        joints = self._joints.at(base.stamp) if robot.joints else {}
        T_base_camera = robot.forward_kinematics(joints, frame)
        pose = self._reckoning.camera_pose(base, T_base_camera, frame)
        pose = PoseRecord(pose.stamp, self._frames.map_frame, pose.transform, pose.covariance)
        self._poses.publish(encode_pose(self._types, pose))
        self.health.produced()


def main() -> int:
    """Run the node."""
    return run_node(DeadReckoningNode)


if __name__ == "__main__":
    raise SystemExit(main())
