"""What map_fusion fuses: clouds, poses, bodies, out of topics."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator
from contextlib import contextmanager
from dataclasses import replace

import numpy as np
from geometry_msgs.msg import PoseWithCovarianceStamped
from sensor_msgs.msg import PointCloud2

from infomap_ros.errors import FrameError, PoseUnavailableError
from infomap_ros.exploration.team.teammate_places import BodyInScan
from infomap_ros.geometry import (
    PoseRecord,
    Record,
    TransformRecord,
    carry_covariance,
)
from infomap_ros.geometry.joint_buffer import JointBufferConfig
from infomap_ros.geometry.pose_buffer import PoseBufferConfig, TransformTree
from infomap_ros.geometry.records import WaitingQueueConfig
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.messages import POINT_CLOUD, decode_pose_with_covariance
from infomap_ros.messages.fields import MessageFields
from infomap_ros.messages.pose_uncertainty import decode_pose_uncertainty
from infomap_ros.nodes.common import qos
from infomap_ros.nodes.common.base import MonitoredNode
from infomap_ros.nodes.robot.odometry_listener import FrameListener
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

CAMERA_POSE = "camera_pose"
_COSINE = 0.9  # of 26 degrees: localization and odometry differ by less, frames of sensors by more
_UNKNOWN = 50  # clouds, after which tf is not asked again where it does not place them


class ScanPoses:
    """Poses of the sensors' frames; implements `scan_synchronizer.CameraPoseSource`.

    While somebody publishes camera_pose it alone says where the robot is: it has a covariance, and
    localization may correct it. Else the pose is that of a cloud's frame in tf, whose covariance is
    unknown. Where `camera_frame` names the frame of camera_pose, tf also gives where clouds of
    other frames were taken. Where it does not, clouds must be of one frame, and camera_pose counts
    as that of it, unless tf has that frame turned another way.

    Args:
        node: that listens.
        located: poses of camera_pose.
        on_change: called when tf may have what is waited for.
    """

    def __init__(
        self, node: MonitoredNode, located: LocatedPoses, on_change: Callable[[], None]
    ) -> None:
        self._node, self._located, self._on_change = node, located, on_change
        self._camera_frame = node.config(ScanSynchronizerConfig).camera_frame
        self._tree = TransformTree(node.config(PoseBufferConfig))
        self._topic = node.resolve_topic_name(CAMERA_POSE)
        self._has_pose, self._by_tf = False, set[str]()
        self._compared, self._unknown = "", 0
        self._frames = FrameListener(node, self._on_edge)
        if node.lockstep is None:  # where camera_pose comes in time: no cloud is placed by tf
            self._frames.listen_to_moving()

    @property
    def places_frames(self) -> bool:
        """Whether tf places clouds, or their frame in that of the camera."""
        return bool(self._camera_frame) or not self._is_published

    def look_from(self, frames: Collection[str]) -> None:
        """Clouds come of these frames."""
        if self._is_published and {self._camera_frame, self._compared}.issuperset(frames):
            self._frames.ignore_moving()
        else:
            self._frames.listen_to_moving()

    def add(self, record: Record) -> None:
        """Take a pose of camera_pose; raises as `LocatedPoses.add`."""
        self._located.add(record)
        self._has_pose = True

    def at(self, stamp: int, frame: str) -> PoseRecord:
        """Pose of a sensor's frame in the map; see `PoseBuffer.at`."""
        if not self._is_published:
            return self._from_tf(stamp, frame)
        pose = self._located.at(stamp)
        if not self._camera_frame:
            self._compare(pose, frame)
        return pose if self._camera_frame in ("", frame) else self._beside(pose, frame)

    def others_have_jumped(self, stamp: int) -> None:
        """See `CameraPoseSource`."""
        self._located.others_have_jumped(stamp)
        self._tree.others_have_jumped(stamp)

    @property
    def _is_published(self) -> bool:
        """Whether somebody publishes camera_pose, and has begun to."""
        return self._has_pose and self._node.count_publishers(self._topic) > 0

    def _on_edge(self, edge: TransformRecord) -> None:
        self._tree.add_transform(edge)
        self._on_change()

    def _from_tf(self, stamp: int, frame: str) -> PoseRecord:
        try:
            with _known(frame):
                pose = self._tree.at(self._located.map_frame, frame, stamp)
        except PoseUnavailableError as error:
            text = f"nothing has come on {CAMERA_POSE}, and in tf: {error}"
            raise PoseUnavailableError(text, error.reason, error.may_arrive) from error
        if frame not in self._by_tf:
            self._by_tf.add(frame)
            self._node.get_logger().info(
                f"without camera_pose clouds are placed by tf, '{self._located.map_frame}' "
                f"to '{frame}', with default_position_sigma and default_rotation_sigma"
            )
            self._node.health.watch(self._topic, required=False)
        return replace(pose, covariance=None)  # also of a chain that never moves

    def _compare(self, pose: PoseRecord, frame: str) -> None:
        """See that camera_pose is of the clouds' frame, as far as tf knows; once for a frame.

        Raises:
            PoseUnavailableError: tf has that frame turned another way.
        """
        if self._compared == frame:
            return
        try:
            by_tf = self._tree.at(pose.frame_id, frame, pose.stamp).transform
        except (FrameError, PoseUnavailableError):
            self._unknown += 1
            self._compared = frame if self._unknown > _UNKNOWN else ""
            return
        cosine = 0.5 * (np.trace(pose.transform[:3, :3].T @ by_tf[:3, :3]) - 1.0)
        if cosine < _COSINE:
            turn = f"turned by {np.degrees(np.arccos(max(cosine, -1.0))):.0f} degrees"
            text = f"{CAMERA_POSE} is {turn} from {frame} in tf: name its frame with camera_frame"
            raise PoseUnavailableError(text, WRONG_FRAME)
        self._compared = frame

    def _beside(self, pose: PoseRecord, frame: str) -> PoseRecord:
        """The pose of a frame beside the camera, of the camera's."""
        with _known(frame):
            T_camera_frame = self._tree.between(self._camera_frame, frame, pose.stamp)
        return carried_pose(pose, T_camera_frame, frame)


@contextmanager
def _known(frame: str) -> Iterator[None]:
    """Where a frame is not in tf, it may still come."""
    try:
        yield
    except FrameError as error:
        reason = f"frame {frame} unknown"
        raise PoseUnavailableError(str(error), reason, may_arrive=True) from error


def carried_pose(pose: PoseRecord, T_child_other: FloatArray, other: str) -> PoseRecord:
    """The pose of another frame that is exactly known in the child frame of a pose."""
    lever = pose.transform[:3, :3] @ T_child_other[:3, 3]
    known, parts = pose.covariance, pose.uncertainty
    if known is not None:
        known = carry_covariance(known, lever)
    if parts is not None:
        drift, white = (carry_covariance(part, lever) for part in (parts.drift, parts.white))
        offset = carry_covariance(parts.offset, lever)
        parts = replace(parts, drift=drift, white=white, offset=offset)
    transform = pose.transform @ T_child_other
    placed = replace(pose, transform=transform, covariance=known, uncertainty=parts)
    return replace(placed, child_frame_id=other)


_UNCERTAINTY = "camera_pose_uncertainty"
_REASONS = (CLOCK_JUMPED, LONE_STAMP, WRONG_FRAME)


class ScanInputs:
    """Listens to clouds, poses and bodies; see `ScanSynchronizer`.

    Args:
        node: that listens; has the configurations of frames, poses, queue and bodies.
        on_scan: gets each complete scan, its cloud not yet decoded.
        on_clock_jump: called when the clouds' clock has jumped back.
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
        frame = node.config(ScanSynchronizerConfig).map_frame
        parts = node.resolve_topic_name(_UNCERTAINTY)
        buffer = node.config(PoseBufferConfig)
        self._poses = LocatedPoses(frame, buffer, lambda: node.count_publishers(parts) > 0)
        self._placed = ScanPoses(node, self._poses, self._take)
        body = self._body = RobotBody(
            config=node.config(JointBufferConfig),
            are_joints_sent=lambda: self._listener is None or self._listener.are_joints_sent,
            required=False,
        )
        self._unknown = ""
        self._listener: BodyListener | None = None
        self._teammates = TeamBodyListener(node, frame, self._take, on_arrival)
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
        self._placed.look_from(self._scans.frames)
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
            self._report_body()

    def _report_body(self) -> None:
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
