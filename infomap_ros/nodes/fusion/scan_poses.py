"""Where clouds were taken: by camera_pose, or where nobody tells it by tf."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from infomap_ros.errors import FrameError, PoseUnavailableError
from infomap_ros.geometry import (
    PoseRecord,
    Record,
    TransformRecord,
    carry_covariance,
    invert_transform,
)
from infomap_ros.geometry.pose_buffer import PoseBufferConfig
from infomap_ros.geometry.transform_tree import TransformTree
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.nodes.common.base import MonitoredNode
from infomap_ros.nodes.robot.frame_listener import FrameListener
from infomap_ros.pipeline.scan_synchronizer import LocatedPoses, ScanSynchronizerConfig

CAMERA_POSE = "camera_pose"


class ScanPoses:
    """Poses of the frame of the clouds; implements `scan_synchronizer.CameraPoseSource`.

    While somebody tells camera_pose it alone counts: it has a covariance, and localization may
    correct it. Else the pose is that of the clouds' frame in tf, whose covariance is unknown. Where
    `camera_frame` names the frame of camera_pose, tf also tells where clouds of other frames were
    taken.

    Args:
        node: that listens.
        located: what camera_pose tells.
        on_news: called when tf may have told what is waited for.

    Attributes:
        cloud_frame: frame of the last cloud.
    """

    def __init__(
        self, node: MonitoredNode, located: LocatedPoses, on_news: Callable[[], None]
    ) -> None:
        self._node, self._located, self._on_news = node, located, on_news
        self._camera_frame = node.config(ScanSynchronizerConfig).camera_frame
        self._tree = TransformTree(node.config(PoseBufferConfig))
        self._topic = node.resolve_topic_name(CAMERA_POSE)
        self._was_told, self.cloud_frame, self._by_tf = False, "", ""
        self._frames = FrameListener(node, self._on_edge)

    def look_from(self, frame: str) -> None:
        """The clouds are of this frame."""
        self.cloud_frame = frame
        if self._is_told and self._camera_frame in ("", frame):
            self._frames.ignore_moving()
        else:
            self._frames.hear_moving()

    def add(self, record: Record) -> None:
        """Take a pose of camera_pose; raises as `LocatedPoses.add`."""
        self._located.add(record)
        self._was_told = True

    def at(self, stamp: int) -> PoseRecord:
        """Pose of the clouds' frame in the map; see `PoseBuffer.at`."""
        if not self._is_told:
            return self._from_tf(stamp)
        pose = self._located.at(stamp)
        return pose if self._camera_frame in ("", self.cloud_frame) else self._of_cloud(pose)

    def others_have_jumped(self, stamp: int) -> None:
        """See `CameraPoseSource`; edges of tf notice a jump by their own stamps."""
        self._located.others_have_jumped(stamp)

    @property
    def _is_told(self) -> bool:
        """Whether somebody tells camera_pose, and has begun to."""
        return self._was_told and self._node.count_publishers(self._topic) > 0

    def _on_edge(self, edge: TransformRecord) -> None:
        self._tree.add_transform(edge)
        if not self._is_told:
            self._on_news()

    def _from_tf(self, stamp: int) -> PoseRecord:
        try:
            pose = self._place(self._located.map_frame, self.cloud_frame, stamp)
        except PoseUnavailableError as error:
            text = f"nothing has come on {CAMERA_POSE}, and in tf: {error}"
            raise PoseUnavailableError(text, error.reason, error.may_arrive) from error
        if self._by_tf != self.cloud_frame:
            self._by_tf = self.cloud_frame
            self._node.get_logger().info(
                f"nobody tells camera_pose: clouds are placed by tf, '{self._located.map_frame}' "
                f"to '{self.cloud_frame}', with default_position_sigma and default_rotation_sigma"
            )
            self._node.health.watch(self._topic, required=False)
        return replace(pose, covariance=None)  # also of a chain that never moves

    def _of_cloud(self, pose: PoseRecord) -> PoseRecord:
        """The pose of the clouds' frame, of that of the camera."""
        root = self._tree.root_of(self.cloud_frame)
        cloud, camera = (
            self._place(root, frame, pose.stamp).transform
            for frame in (self.cloud_frame, self._camera_frame)
        )
        return carried_pose(pose, invert_transform(camera) @ cloud)

    def _place(self, target: str, frame: str, stamp: int) -> PoseRecord:
        try:
            return self._tree.at(target, frame, stamp)
        except FrameError as error:
            reason = f"frame {frame} unknown"
            raise PoseUnavailableError(str(error), reason, may_arrive=True) from error


def carried_pose(pose: PoseRecord, T_child_other: FloatArray) -> PoseRecord:
    """The pose of a frame that is exactly known in the child frame of a pose."""
    lever = pose.transform[:3, :3] @ T_child_other[:3, 3]
    known, parts = pose.covariance, pose.uncertainty
    return replace(
        pose,
        transform=pose.transform @ T_child_other,
        covariance=None if known is None else carry_covariance(known, lever),
        uncertainty=None
        if parts is None
        else replace(
            parts,
            drift=carry_covariance(parts.drift, lever),
            white=carry_covariance(parts.white, lever),
            offset=carry_covariance(parts.offset, lever),
        ),
    )
