"""What fiducial_localization publishes: poses, frames, fiducials, keyframes."""

from __future__ import annotations

import numpy as np
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import Point, PoseWithCovarianceStamped
from nav_msgs.msg import Path
from numpy.typing import NDArray
from sensor_msgs.msg import PointCloud2
from std_msgs.msg import ColorRGBA
from visualization_msgs.msg import Marker, MarkerArray

from infomap_ros.geometry import PoseRecord
from infomap_ros.localization.filter.records import Fiducials, KeptPoses
from infomap_ros.localization.localized_camera import LocalizedCamera
from infomap_ros.messages import encode_pose
from infomap_ros.messages.fiducials import encode_fiducials, fiducial_rows
from infomap_ros.messages.keyframes import (
    KeyframePoses,
    encode_keyframe_covariances,
    encode_keyframe_poses,
)
from infomap_ros.messages.pose_uncertainty import encode_pose_uncertainty
from infomap_ros.nodes.common import qos
from infomap_ros.nodes.common.base import MonitoredNode
from infomap_ros.nodes.common.message_types import RclpyMessageTypes
from infomap_ros.nodes.locating.localization_status import LOCALIZATION_STATUS, status_message

_SIZE = 0.04  # of a marker [m]


class LocalizationOutputs:
    """The publishers. Nothing is built that nobody subscribes to, but poses and frames.

    Args:
        node: that publishes.
        map_frame: name of the map's frame.
    """

    def __init__(self, node: MonitoredNode, map_frame: str) -> None:
        self._types, self._map = RclpyMessageTypes(), map_frame
        self._uncertainties = node.advertise(PointCloud2, "camera_pose_uncertainty", qos.stream(50))
        self._poses = node.advertise(PoseWithCovarianceStamped, "camera_pose", qos.stream(50))
        self._keyframes = node.advertise(Path, "keyframe_poses", qos.stream())
        self._covariances = node.advertise(PointCloud2, "keyframe_covariances", qos.stream())
        self._fiducials = node.advertise(PointCloud2, "fiducials", qos.latched())
        self._markers = node.advertise(MarkerArray, "fiducial_markers", qos.latched())
        self._status = node.advertise(DiagnosticStatus, LOCALIZATION_STATUS, qos.latched())

    def publish_status(self, result: LocalizedCamera) -> None:
        """Publish what became of a view; latched, so that who comes late knows it too."""
        self._status.publish(status_message(result))

    def publish_pose(self, pose: PoseRecord) -> None:
        """Publish the camera's pose in the map.

        The parts of its covariance go first: who receives the pose has them at hand.
        """
        if pose.uncertainty is not None and self._uncertainties.get_subscription_count():
            self._uncertainties.publish(
                encode_pose_uncertainty(self._types, pose.stamp, pose.frame_id, pose.uncertainty)
            )
        self._poses.publish(encode_pose(self._types, pose))

    def publish_keyframes(self, stamp: int, kept: KeptPoses, origin: int) -> None:
        """Publish where the camera was at the keyframes, as it is known at `stamp` [ns].

        Covariances go first: who hears the poses has them at hand.
        """
        content = kept.stamps, kept.transforms, kept.covariances
        record = KeyframePoses(stamp, self._map, *content, origin=origin)
        if self._covariances.get_subscription_count():
            self._covariances.publish(encode_keyframe_covariances(self._types, record))
        if self._keyframes.get_subscription_count():
            self._keyframes.publish(encode_keyframe_poses(self._types, record))

    @property
    def fiducials_wanted(self) -> bool:
        """Whether anybody subscribes to fiducials or their markers."""
        publishers = (self._fiducials, self._markers)
        return any(publisher.get_subscription_count() for publisher in publishers)

    def publish_fiducials(self, stamp: int, fiducials: Fiducials) -> None:
        """Publish the scene's fiducials as they are known at `stamp` [ns]."""
        if self._fiducials.get_subscription_count():
            self._fiducials.publish(encode_fiducials(self._types, stamp, self._map, fiducials))
        if self._markers.get_subscription_count():
            marker = self._marker(stamp, fiducial_rows(fiducials))
            self._markers.publish(MarkerArray(markers=[marker]))

    def _marker(self, stamp: int, rows: NDArray[np.void]) -> Marker:
        """All fiducials as balls: green where they are known to a centimeter, red from 10 cm on."""
        marker = Marker(ns="fiducials", id=0, type=Marker.SPHERE_LIST, action=Marker.ADD)
        marker.header.frame_id = self._map
        marker.header.stamp.sec, marker.header.stamp.nanosec = divmod(stamp, 1_000_000_000)
        marker.scale.x = marker.scale.y = marker.scale.z = _SIZE
        marker.pose.orientation.w = 1.0
        for row in rows:
            share = float(np.clip(np.log10(max(row["sigma"], 1e-6) / 0.01), 0.0, 1.0))
            marker.points.append(Point(x=float(row["x"]), y=float(row["y"]), z=float(row["z"])))
            marker.colors.append(ColorRGBA(r=share, g=1.0 - share, b=0.1, a=0.9))
        return marker
