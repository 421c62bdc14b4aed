"""Where the camera was, from whatever tells it: its own pose, odometry or tf."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from infomap_ros.errors import FrameError, PoseUnavailableError
from infomap_ros.geometry import (
    OdometryRecord,
    PoseBufferConfig,
    PoseRecord,
    Record,
    TransformRecord,
)
from infomap_ros.geometry.transform_tree import TransformTree


class CameraPoses:
    """Poses of the camera's optical frame in the map frame.

    A pose topic tells the pose of one frame: that which its message names (odometry), else
    `pose_frame`, else the camera itself. From there to the camera the edges of tf lead, which
    come from a robot's joints and are taken as exact. Where tf alone tells the pose, its
    covariance is unknown.

    Attributes:
        camera_frame: the camera's optical frame.
        map_frame: the frame in which poses are told; empty before the first.
    """

    def __init__(
        self,
        camera_frame: str,
        config: PoseBufferConfig | None = None,
        *,
        by_tf: bool = False,
        map_frame: str = "",
        pose_frame: str = "",
        static: Iterable[TransformRecord] = (),
    ) -> None:
        """Start with the fixed edges.

        Args:
            camera_frame: the camera's optical frame.
            config: of the poses that are kept.
            by_tf: True where no pose topic is used.
            map_frame: frame of the map; that of the first pose where empty, with tf alone
                ``map`` if there is one, else the topmost frame.
            pose_frame: frame of which the pose topic tells the pose, where its messages do not.
            static: edges of tf_static.
        """
        self.camera_frame, self.map_frame = camera_frame, map_frame
        self._by_tf, self._pose_frame = by_tf, pose_frame
        self._posed = ""  # frame of which the pose topic tells the pose
        self._base = ""  # frame in which it does
        self._tree = TransformTree(config)
        for edge in static:
            self._tree.add_transform(edge)

    def add(self, record: Record) -> None:
        """Take a pose, odometry or transform; other records are ignored.

        Raises:
            FrameError: the frames contradict those before.
        """
        if isinstance(record, TransformRecord):
            self._add_transform(record)
        elif isinstance(record, PoseRecord) and not self._by_tf:
            told = record.child_frame_id if isinstance(record, OdometryRecord) else ""
            self._posed = told or self._pose_frame or self.camera_frame
            self._base = record.frame_id
            self.map_frame = self.map_frame or record.frame_id
            self._tree.add_pose(record, self._posed)

    def _add_transform(self, edge: TransformRecord) -> None:
        if edge.child_frame_id == self._posed:
            return  # the pose topic tells more of the same edge
        if edge.is_static or self._by_tf or edge.child_frame_id == self._base:
            self._tree.add_transform(edge)
            return
        exact = PoseRecord(edge.stamp, edge.frame_id, edge.transform, np.zeros((6, 6)))
        self._tree.add_pose(exact, edge.child_frame_id)

    def at(self, stamp: int) -> PoseRecord:
        """Pose of the camera at a time.

        Args:
            stamp: [ns].

        Raises:
            PoseUnavailableError: it is not known at that time.
        """
        map_frame = self.map_frame or self._top_frame()
        if not map_frame:
            raise PoseUnavailableError("no pose has arrived", "no pose", may_arrive=True)
        try:
            return self._tree.at(map_frame, self.camera_frame, stamp)
        except FrameError as error:
            reason = f"frame {self.camera_frame} has no place in {map_frame}"
            raise PoseUnavailableError(str(error), reason, may_arrive=True) from error

    def others_have_jumped(self, stamp: int) -> None:
        """The images' clock has jumped back; each edge notices that by its own stamps."""

    def _top_frame(self) -> str:
        if not self._by_tf:
            return ""
        top = self._tree.root_of(self.camera_frame)
        return "" if top == self.camera_frame else top
