"""What fiducial_localization reports of each view, in messages, diagnostics and its log."""

from __future__ import annotations

import math
import threading
import time

import numpy as np
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import Point, PoseWithCovarianceStamped
from nav_msgs.msg import Path
from numpy.typing import NDArray
from sensor_msgs.msg import PointCloud2
from std_msgs.msg import ColorRGBA
from visualization_msgs.msg import Marker, MarkerArray

from infomap_ros.errors import FrameError, PoseUnavailableError
from infomap_ros.geometry import PoseRecord, TransformRecord, invert_transform
from infomap_ros.geometry.pose_buffer import TransformTree
from infomap_ros.localization.filter.config import Fiducials, KeptPoses
from infomap_ros.localization.filter.motion_prior import RobotPosture
from infomap_ros.localization.localized_camera import LocalizedCamera
from infomap_ros.messages import encode_pose
from infomap_ros.messages.fiducials import encode_fiducials, fiducial_rows
from infomap_ros.messages.motions import (
    KeyframePoses,
    encode_keyframe_covariances,
    encode_keyframe_poses,
)
from infomap_ros.messages.pose_uncertainty import encode_pose_uncertainty
from infomap_ros.nodes.common import qos
from infomap_ros.nodes.common.base import MonitoredNode
from infomap_ros.nodes.common.message_types import RclpyMessageTypes
from infomap_ros.nodes.locating.base_topics import (
    BaseOdometry,
    MapFrameConfig,
    OdomFrameBroadcaster,
    frame_publisher,
)
from infomap_ros.nodes.locating.localization_config import FiducialLocalizationConfig
from infomap_ros.nodes.locating.localization_status import LOCALIZATION_STATUS, status_message
from infomap_ros.nodes.robot.odometry_listener import FrameListener
from infomap_ros.nodes.robot.robot_tracker import RobotTrackerConfig
from infomap_ros.pipeline.camera_localizer import CameraLocalizer, KeyframeChanges

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

    def publish_status(self, result: LocalizedCamera, team: str) -> None:
        """Publish what became of a view; latched, so that who comes late knows it too."""
        self._status.publish(status_message(result, team))

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

        Covariances go first: who receives the poses has them at hand.
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


_LOOK_PERIOD = 0.1  # [s]
_FIDUCIALS_PERIOD = 1.0  # shortest between two publications of fiducials, by their stamps [s]
_DISCOVERY = 0.5  # [s], in which publishers of /tf are found


class CameraRoot:
    """Finds the topmost frame above the camera in tf: it gets the map as its parent.

    A frame has one parent only, so that a camera on a robot, whose description says where it is,
    must not be placed itself. It listens to /tf once it is asked. May be used by any thread.

    Args:
        node: that listens.
        map_frame: name of the map's frame.
    """

    def __init__(self, node: MonitoredNode, map_frame: str) -> None:
        self._node, self._map = node, map_frame
        self._lock = threading.Lock()
        self._tree = TransformTree()
        self._own: set[str] = set()
        self._is_placed = self._is_needed = False
        self._since = math.inf
        self._frames = FrameListener(node, self._on_edge)
        node.repeat(_LOOK_PERIOD, self._look)

    def note_own(self, child: str) -> None:
        """This node itself places a frame in the map."""
        with self._lock:
            self._own.add(child)

    def below_map(self, camera: PoseRecord) -> TransformRecord | None:
        """The transform that places the camera in the map.

        Args:
            camera: its pose in the map.

        Returns:
            The map to the topmost frame above the camera, which may be the camera itself; None
            where somebody else has placed that, or tf does not say where the camera is on it at
            that time.
        """
        with self._lock:
            self._is_needed = True
            if self._is_placed or time.monotonic() < self._since + _DISCOVERY:
                return None
            try:
                root = self._tree.root_of(camera.child_frame_id)
                on_root = self._tree.at(root, camera.child_frame_id, camera.stamp).transform
            except (FrameError, PoseUnavailableError):
                return None
            self._own.add(root)
        T_map_root = camera.transform @ invert_transform(on_root)
        return TransformRecord(camera.stamp, self._map, root, T_map_root)

    def _look(self) -> None:
        if self._is_needed and self._since == math.inf:
            self._frames.listen_to_moving()
            self._since = time.monotonic()

    def _on_edge(self, edge: TransformRecord) -> None:
        with self._lock:
            if edge.frame_id != self._map:
                self._tree.add_transform(edge)
            elif edge.child_frame_id not in self._own and not self._is_placed:
                self._is_placed = True
                text = f"somebody else places '{edge.child_frame_id}' in '{self._map}' on /tf"
                self._node.get_logger().warning(f"{text}: this node does not")


class LocalizationReporter:
    """Reports what became of each view. Used by one thread.

    Args:
        node: that reports.
        localizer: knows keyframes and fiducials.
    """

    def __init__(self, node: MonitoredNode, localizer: CameraLocalizer) -> None:
        self._node, self._localizer = node, localizer
        self._config = node.config(FiducialLocalizationConfig)
        self._map = node.config(RobotTrackerConfig).map_frame
        self._outputs = LocalizationOutputs(node, self._map)
        tolerance = node.config(MapFrameConfig).transform_tolerance
        self._publish_frame = frame_publisher(node)
        self._odom_frame = OdomFrameBroadcaster(node, self._publish_frame, tolerance)
        self._root = CameraRoot(node, self._map)
        self._base = BaseOdometry(node)
        self._state = ""
        self._changes = KeyframeChanges()
        self._sent_fiducials = -(2**62)
        node.health.condition("no image has been looked at yet")

    def report(
        self,
        result: LocalizedCamera,
        camera_frame: str,
        posture: RobotPosture | None,
        odom_frame: str,
        team: str = "",
    ) -> None:
        """Report on one view.

        Args:
            result: what is known of the camera.
            camera_frame: its optical frame.
            posture: of the robot at that time, if it is known.
            odom_frame: frame of odometry, empty where there is none.
            team: whether teammates are looked for, as of `LocalizationState`.
        """
        self._note(result)
        self._outputs.publish_status(result, team)
        if result.T_map_camera is None:
            return
        located = result.T_map_camera, result.covariance, camera_frame
        pose = PoseRecord(result.stamp, self._map, *located, uncertainty=result.uncertainty)
        self._outputs.publish_pose(pose)
        self._send_frame(pose, posture, odom_frame)
        self._send_keyframes(result)
        self._send_fiducials(result.stamp)
        self._node.health.produced()

    def _send_frame(self, pose: PoseRecord, posture: RobotPosture | None, odom_frame: str) -> None:
        """The map to odometry, so that only odometry's child frames move between two views."""
        if posture is not None:
            T_map_odom = pose.transform @ invert_transform(posture.T_odom_camera)
            edge = TransformRecord(pose.stamp, self._map, odom_frame, T_map_odom)
            self._root.note_own(odom_frame)
            self._odom_frame.update(edge)
            self._base.publish(pose, posture.T_base_camera)
        elif not odom_frame and (below := self._root.below_map(pose)) is not None:
            self._publish_frame(below)

    def _send_keyframes(self, result: LocalizedCamera) -> None:
        """Keyframes, where there is a new one or one has moved."""
        kept = self._changes.after(result, self._localizer.keyframes())
        if kept is not None:
            origin = 0 if result.uncertainty is None else result.uncertainty.origin
            self._outputs.publish_keyframes(result.stamp, kept, origin)

    def _send_fiducials(self, stamp: int) -> None:
        fiducials = self._localizer.fiducials()
        since = 1e-9 * (stamp - self._sent_fiducials)
        if fiducials is None or 0.0 <= since < _FIDUCIALS_PERIOD:
            return
        if self._outputs.fiducials_wanted:
            self._sent_fiducials = stamp
            self._outputs.publish_fiducials(stamp, fiducials)

    def _note(self, result: LocalizedCamera) -> None:
        """Say in diagnostics, and where the state is another one in the log, how it goes."""
        health, sentence = self._node.health, _sentence(result)
        health.note("stamp", str(result.stamp))
        health.condition("" if result.state == "tracking" else sentence)
        health.note("state", result.state)
        health.note("reason", result.reason)
        health.note("fiducials tracked", str(result.tracked))
        if result.covariance is not None:
            position, rotation = (np.trace(result.covariance[s, s]) for s in _PARTS)
            health.note("position sigma [m]", f"{np.sqrt(position):.4f}")
            health.note("rotation sigma [rad]", f"{np.sqrt(rotation):.4f}")
        if result.state != self._state:
            self._state = result.state
            if result.state == "lost":
                self._node.get_logger().warning(sentence)
            else:
                self._node.get_logger().info(sentence)


_PARTS = (slice(0, 3), slice(3, 6))


def _sentence(result: LocalizedCamera) -> str:
    return f"{result.state}: {result.reason}" if result.reason else result.state
