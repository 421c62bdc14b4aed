"""What fiducial_localization tells of each view, in messages, diagnostics and its log."""

from __future__ import annotations

import numpy as np

from infomap_ros.geometry import PoseRecord, TransformRecord, invert_transform
from infomap_ros.localization.filter.motion_prior import RobotPosture
from infomap_ros.localization.localized_camera import LocalizedCamera
from infomap_ros.nodes.common.base import MonitoredNode
from infomap_ros.nodes.locating.base_topics import BaseOdometry
from infomap_ros.nodes.locating.camera_root import CameraRoot
from infomap_ros.nodes.locating.localization_config import FiducialLocalizationConfig
from infomap_ros.nodes.locating.localization_outputs import LocalizationOutputs
from infomap_ros.nodes.locating.odom_frame import (
    MapFrameConfig,
    OdomFrameBroadcaster,
    frame_publisher,
)
from infomap_ros.nodes.robot.robot_tracker import RobotTrackerConfig
from infomap_ros.pipeline.camera_localizer import CameraLocalizer
from infomap_ros.pipeline.keyframe_changes import KeyframeChanges


class LocalizationNews:
    """Tells what became of each view. Used by one thread.

    Args:
        node: that tells.
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
        self._changes = KeyframeChanges(self._config.min_correction)
        self._told_fiducials = -(2**62)
        node.health.condition("no image has been looked at yet")

    def tell(
        self,
        result: LocalizedCamera,
        camera_frame: str,
        posture: RobotPosture | None,
        odom_frame: str,
    ) -> None:
        """Tell of one view.

        Args:
            result: what is known of the camera.
            camera_frame: its optical frame.
            posture: of the robot at that time, if it is known.
            odom_frame: frame of odometry, empty where there is none.
        """
        self._note(result)
        self._outputs.publish_status(result)
        if result.T_map_camera is None:
            return
        told = result.T_map_camera, result.covariance, camera_frame
        pose = PoseRecord(result.stamp, self._map, *told, uncertainty=result.uncertainty)
        self._outputs.publish_pose(pose)
        self._tell_frame(pose, posture, odom_frame)
        self._tell_keyframes(result)
        self._tell_fiducials(result.stamp)
        self._node.health.produced()

    def _tell_frame(self, pose: PoseRecord, posture: RobotPosture | None, odom_frame: str) -> None:
        """The map to odometry, so that only odometry's child frames move between two views."""
        if posture is not None:
            T_map_odom = pose.transform @ invert_transform(posture.T_odom_camera)
            edge = TransformRecord(pose.stamp, self._map, odom_frame, T_map_odom)
            self._root.note_own(odom_frame)
            self._odom_frame.update(edge)
            self._base.publish(pose, posture.T_base_camera)
        elif not odom_frame and (below := self._root.below_map(pose)) is not None:
            self._publish_frame(below)

    def _tell_keyframes(self, result: LocalizedCamera) -> None:
        """Keyframes, where there is a new one or one has moved."""
        kept = self._changes.after(result, self._localizer.keyframes())
        if kept is not None:
            origin = 0 if result.uncertainty is None else result.uncertainty.origin
            self._outputs.publish_keyframes(result.stamp, kept, origin)

    def _tell_fiducials(self, stamp: int) -> None:
        period, fiducials = self._config.fiducials_period, self._localizer.fiducials()
        since = 1e-9 * (stamp - self._told_fiducials)
        if fiducials is None or 0.0 <= since < period:
            return
        if self._outputs.fiducials_wanted:
            self._told_fiducials = stamp
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
