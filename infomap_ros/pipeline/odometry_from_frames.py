"""Odometry out of tf, for robots whose driver publishes no odometry but that."""

from __future__ import annotations

from infomap_ros.errors import FrameError, PoseUnavailableError
from infomap_ros.geometry import OdometryRecord, TransformRecord
from infomap_ros.geometry.transform_tree import TransformTree


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
