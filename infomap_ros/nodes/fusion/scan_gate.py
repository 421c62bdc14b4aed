"""Clouds wait here until the places of camera, robot and teammates at their stamps are known.

When the clock jumps back (a bag that loops), clouds from before the jump still get the poses from
before it, and those after it never do. What still waits when the clouds have jumped is dropped.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

from geometry_msgs.msg import PoseWithCovarianceStamped
from sensor_msgs.msg import PointCloud2

from infomap_ros.errors import FrameError
from infomap_ros.exploration.team.bodies_in_scan import BodyInScan
from infomap_ros.geometry import PlacedSolid, PoseRecord
from infomap_ros.geometry.pose_buffer import PoseBuffer, PoseBufferConfig
from infomap_ros.geometry.waiting_queue import WaitingQueue, WaitingQueueConfig
from infomap_ros.messages import POINT_CLOUD, decode_pose_with_covariance
from infomap_ros.messages.fields import MessageFields
from infomap_ros.nodes.common import qos
from infomap_ros.nodes.common.base import MonitoredNode
from infomap_ros.nodes.common.clock_jumps import JumpingBuffer
from infomap_ros.nodes.fusion.scan_gate_config import ScanGateConfig
from infomap_ros.nodes.robot.robot_body import RobotBody
from infomap_ros.nodes.team.team_bodies import TeamBodyListener

_NO_POSE = "no pose at the stamp"
_REASONS = {"time went backwards": "time went backwards"}


@dataclass(frozen=True, eq=False)
class Scan:
    """A cloud that can be fused.

    Attributes:
        message: the cloud, not yet decoded.
        pose: of the camera at its stamp.
        body: the robot's solids in the frame of the cloud at its stamp.
        teammates: their bodies there.
    """

    message: PointCloud2
    pose: PoseRecord
    body: Sequence[PlacedSolid]
    teammates: Sequence[BodyInScan] = ()


class ScanGate:
    """Listens to clouds and poses and lets scans through when they are complete.

    Args:
        node: that listens; has the configurations of gate, poses, queue and body.
        on_scan: gets each complete scan.
        on_clock_jump: told when the clouds' clock has jumped back.
        on_arrival: gets the body of a teammate that is new or back, placed in the map.
    """

    def __init__(
        self,
        node: MonitoredNode,
        on_scan: Callable[[Scan], None],
        on_clock_jump: Callable[[], None],
        on_arrival: Callable[[BodyInScan], None],
    ) -> None:
        self._node = node
        self._on_scan, self._on_clock_jump = on_scan, on_clock_jump
        self._map_frame = node.config(ScanGateConfig).map_frame
        self._camera_frame = node.config(ScanGateConfig).camera_frame
        poses, waiting = node.config(PoseBufferConfig), node.config(WaitingQueueConfig)
        self._poses = JumpingBuffer(lambda: PoseBuffer(poses), round(poses.max_gap * 1e9))
        self._jump = round(waiting.max_wait * 1e9)
        self._newest = 0
        self._waiting: WaitingQueue[PointCloud2] = WaitingQueue(
            self._pose_at, waiting, lambda _, why: node.drop(_REASONS.get(why, _NO_POSE), why)
        )
        self._body = RobotBody(node, on_news=self._let_through)
        news = self._let_through, on_arrival
        self._teammates = TeamBodyListener(node, self._map_frame, *news)
        self._pose_stamp = 0
        node.listen(PointCloud2, "points2", self._on_cloud, qos.sensor_data())
        pose_type = PoseWithCovarianceStamped
        node.listen(pose_type, "camera_pose", self._on_pose, qos.sensor_data(depth=50))

    def _on_pose(self, message: PoseWithCovarianceStamped) -> None:
        pose = decode_pose_with_covariance(message)
        if pose.frame_id != self._map_frame:
            raise FrameError(f"pose in frame '{pose.frame_id}', the map is '{self._map_frame}'")
        self._poses.add(pose)
        self._pose_stamp = pose.stamp
        self._let_through()

    def _on_cloud(self, message: PointCloud2) -> None:
        stamp, frame = MessageFields(message, POINT_CLOUD).header()
        self._camera_frame = self._camera_frame or frame
        if frame != self._camera_frame:
            raise FrameError(f"cloud in frame '{frame}', camera_pose is of '{self._camera_frame}'")
        if stamp < self._newest - self._jump:
            self._jump_back(stamp)
        self._newest = max(self._newest, stamp)
        self._waiting.push(stamp, message)
        self._let_through()

    def _jump_back(self, stamp: int) -> None:
        """The clouds have jumped: see the module."""
        self._node.get_logger().warning("time went backwards")
        self._newest = stamp
        self._waiting.drop_all("time went backwards")
        self._poses.others_have_jumped(stamp)
        self._body.clouds_have_jumped(stamp)
        self._on_clock_jump()

    def _pose_at(self, stamp: int) -> PoseRecord:
        """The camera's pose, once the places of the body and of teammates' are known too."""
        self._body.check_known_at(stamp)
        pose = self._poses.at(stamp)
        newest = max(self._newest, self._pose_stamp, self._body.newest_stamp)
        self._teammates.check_known_at(stamp, newest)
        return pose

    def _let_through(self) -> None:
        for message, pose in self._waiting.take():
            self._node.guard("points2", partial(self._complete, message, pose))

    def _complete(self, message: PointCloud2, pose: PoseRecord) -> None:
        body = self._body.solids_in(self._camera_frame, pose.stamp)
        self._on_scan(Scan(message, pose, body, self._teammates.bodies_in(pose)))
