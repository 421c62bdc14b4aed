"""What map_fusion fuses: clouds, poses, bodies, out of topics."""

from __future__ import annotations

from collections.abc import Callable

from geometry_msgs.msg import PoseWithCovarianceStamped
from sensor_msgs.msg import PointCloud2

from infomap_ros.exploration.team.bodies_in_scan import BodyInScan
from infomap_ros.geometry.joint_buffer import JointBufferConfig
from infomap_ros.geometry.pose_buffer import PoseBufferConfig
from infomap_ros.geometry.waiting_queue import WaitingQueueConfig
from infomap_ros.messages import POINT_CLOUD, decode_pose_with_covariance
from infomap_ros.messages.fields import MessageFields
from infomap_ros.messages.pose_uncertainty import decode_pose_uncertainty
from infomap_ros.nodes.common import qos
from infomap_ros.nodes.common.base import MonitoredNode
from infomap_ros.nodes.fusion.scan_poses import CAMERA_POSE, ScanPoses
from infomap_ros.nodes.robot.robot_body import BodyListener, RobotBodyConfig
from infomap_ros.nodes.team.team_bodies import TeamBodyListener
from infomap_ros.pipeline.clock_jumps import LONE_STAMP
from infomap_ros.pipeline.robot_body import RobotBody
from infomap_ros.pipeline.scan_synchronizer import (
    CLOCK_JUMPED,
    WRONG_FRAME,
    LocatedPoses,
    Scan,
    ScanSynchronizer,
    ScanSynchronizerConfig,
)

_UNCERTAINTY = "camera_pose_uncertainty"
_REASONS = (CLOCK_JUMPED, LONE_STAMP, WRONG_FRAME)


class ScanInputs:
    """Listens to clouds, poses and bodies; see `ScanSynchronizer`.

    Args:
        node: that listens; has the configurations of frames, poses, queue and bodies.
        on_scan: gets each complete scan, its cloud not yet decoded.
        on_clock_jump: told when the clouds' clock has jumped back.
        on_arrival: gets the body of a teammate that is new or back, placed in the map.
    """

    def __init__(
        self,
        node: MonitoredNode,
        on_scan: Callable[[Scan[PointCloud2]], None],
        on_clock_jump: Callable[[], None],
        on_arrival: Callable[[BodyInScan], None],
    ) -> None:
        self._node, self._on_scan, self._on_clock_jump = node, on_scan, on_clock_jump
        frame, parts = (
            node.config(ScanSynchronizerConfig).map_frame,
            node.resolve_topic_name(_UNCERTAINTY),
        )
        self._poses = LocatedPoses(
            frame,
            node.config(PoseBufferConfig),
            lambda: node.count_publishers(parts) > 0,
        )
        self._placed = ScanPoses(node, self._poses, self._take)
        body = self._body = RobotBody(
            config=node.config(JointBufferConfig),
            are_joints_told=lambda: self._listener is None or self._listener.are_joints_told,
            required=False,
        )
        self._unknown = ""
        self._listener: BodyListener | None = None
        news = self._take, on_arrival
        self._teammates = TeamBodyListener(node, frame, *news)
        self._scans: ScanSynchronizer[PointCloud2] = ScanSynchronizer(
            self._placed,
            body,
            self._teammates,
            waiting=node.config(WaitingQueueConfig),
            on_drop=self._on_drop,
            on_clock_jump=self._on_jump,
        )
        if node.config(RobotBodyConfig).remove_body:
            self._listener = BodyListener(node, body, self._take)
        stream = qos.sensor_data(depth=50)
        node.listen(PointCloud2, "points2", self._on_cloud, qos.sensor_data())
        node.listen(PointCloud2, _UNCERTAINTY, self._on_uncertainty, stream, required=False)
        node.listen(PoseWithCovarianceStamped, CAMERA_POSE, self._on_pose, stream)

    def _on_cloud(self, message: PointCloud2) -> None:
        stamp, frame = MessageFields(message, POINT_CLOUD).header()
        self._scans.add_cloud(stamp, frame, message)
        self._placed.look_from(frame)
        if self._listener is not None:
            self._listener.look_from(frame)
        self._take()

    def _on_jump(self) -> None:
        self._node.get_logger().warning(CLOCK_JUMPED)
        self._on_clock_jump()

    def _on_pose(self, message: PoseWithCovarianceStamped) -> None:
        self._scans.add_pose(decode_pose_with_covariance(message))
        self._take()

    def _on_uncertainty(self, message: PointCloud2) -> None:
        stamp, _, uncertainty = decode_pose_uncertainty(message)
        self._poses.add_uncertainty(stamp, uncertainty)
        self._take()

    def _take(self) -> None:
        for scan in self._scans.take():
            self._on_scan(scan)
            self._tell_of_body()

    def _tell_of_body(self) -> None:
        """Warn once of scans in which the robot itself may be."""
        unknown = self._body.unknown
        if unknown != self._unknown:
            self._unknown = unknown
            self._node.health.note("body", f"stays in scans: {unknown}" if unknown else "removed")
            if unknown:
                text = f"the robot's body is not taken out of scans: {unknown}"
                self._node.get_logger().warning(text)

    def _on_drop(self, reason: str, sentence: str) -> None:
        self._node.drop(reason if reason in _REASONS else "no pose at the stamp", sentence)
