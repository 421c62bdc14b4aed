"""Tags that another node detects: from apriltag_ros's message to the pose in the map."""

from __future__ import annotations

from array import array
from functools import partial
from importlib.util import find_spec
from typing import Any

import numpy as np
import pytest
from geometry_msgs.msg import PoseWithCovarianceStamped
from rclpy.qos import QoSProfile
from sensor_msgs.msg import CameraInfo, Image

from infomap_ros.geometry import invert_transform, make_transform, transform_points
from infomap_ros.localization.target.tag_board import TagBoard
from infomap_ros.messages import decode_pose_with_covariance
from infomap_ros.messages.fiducials import TAG_DETECTIONS
from infomap_ros.nodes.common.message_types import message_class
from infomap_ros.nodes.fiducial_localization import FiducialLocalizationNode
from test.localization.tag_scenes import CAMERA, seen_from

pytestmark = pytest.mark.skipif(
    find_spec("apriltag_msgs") is None, reason="apriltag_msgs is not built; see make setup"
)
FRAME, STEP = "camera_optical_frame", 500_000_000
BOARD = TagBoard()


class Stage:
    """A depth camera before a board of which its image shows nothing, and a node."""

    def __init__(self, graph: Any) -> None:
        self.graph, self.poses = graph, {}
        self.node = graph.add(
            FiducialLocalizationNode,
            source="depth",
            motion="none",
            use_detections=True,
            target__kind="tags",
        )
        self._depth, self._image = (
            graph.publisher(Image, topic) for topic in ("depth/image_rect", "rgb/image_rect")
        )
        self._info = graph.publisher(CameraInfo, "depth/camera_info")
        self._tags = graph.publisher(message_class(TAG_DETECTIONS), "detections")
        graph.tester.create_subscription(
            PoseWithCovarianceStamped, "camera_pose", self._on_pose, QoSProfile(depth=100)
        )
        graph.connect(self._depth, self._image, self._info, self._tags)

    def _on_pose(self, message: PoseWithCovarianceStamped) -> None:
        pose = decode_pose_with_covariance(message)
        self.poses[pose.stamp] = pose

    def look(self, number: int, T_camera_target: np.ndarray) -> int:
        """Publish the images of a moment; returns its stamp."""
        v, u = np.mgrid[: CAMERA.height, : CAMERA.width]
        rays = np.stack([u, v, np.ones_like(u)], -1) @ np.linalg.inv(CAMERA.matrix).T
        normal = (T_camera_target @ BOARD.T_target_board)[:3, 2]
        depth = normal @ T_camera_target[:3, 3] / (rays @ normal)
        gray = np.full(depth.shape, 128, np.uint8)
        info = CameraInfo(width=CAMERA.width, height=CAMERA.height, distortion_model="plumb_bob")
        info.k, info.r = CAMERA.matrix.ravel(), np.eye(3).ravel()
        info.p = np.hstack([CAMERA.matrix, np.zeros((3, 1))]).ravel()
        self._info.publish(self.stamp(info, number * STEP))
        for publisher, encoding, pixels in (
            (self._depth, "32FC1", depth.astype(np.float32)),
            (self._image, "mono8", gray),
        ):
            image = Image(height=len(pixels), width=640, encoding=encoding, step=pixels.strides[0])
            image.data = array("B", pixels.tobytes())
            publisher.publish(self.stamp(image, number * STEP))
        return number * STEP

    def stamp(self, message: Any, stamp: int) -> Any:
        message.header.frame_id = FRAME
        message.header.stamp.sec, message.header.stamp.nanosec = divmod(stamp, 10**9)
        return message

    def detect(self, number: int, T_camera_target: np.ndarray, rng: np.random.Generator) -> Any:
        """What apriltag_ros tells of a moment, with 0.1 px of noise."""
        message = message_class(TAG_DETECTIONS)()
        for one, square in zip(BOARD.ids, BOARD.corners, strict=True):
            tag = message_class("apriltag_msgs/msg/AprilTagDetection")()
            tag.family, tag.id, tag.decision_margin = "tag36h11", one, 80.0
            top_left, top_right, bottom_right, bottom_left = (
                CAMERA.project(transform_points(T_camera_target, square))
                + rng.normal(0.0, 0.1, (4, 2))
                + 0.5
            )
            # As it stands, the print is upside down for AprilTag.
            told = (top_right, top_left, bottom_left, bottom_right)
            for corner, (x, y) in zip(tag.corners, told, strict=True):
                corner.x, corner.y = float(x), float(y)
            message.detections.append(tag)
        return self.stamp(message, number * STEP)

    def publish(self, message: Any) -> None:
        self._tags.publish(message)

    def check(self, stamp: int, T_camera_target: np.ndarray) -> None:
        """The pose of a stamp is the true one, as well as it says."""
        self.graph.spin_until(lambda: stamp in self.poses, f"the pose at {stamp}")
        found, truth = self.poses[stamp], invert_transform(T_camera_target)
        error = found.transform[:3, 3] - truth[:3, 3]
        assert np.linalg.norm(error) < 0.02
        assert error @ np.linalg.solve(found.covariance[:3, :3], error) < 16.3
        turn = found.transform[:3, :3].T @ truth[:3, :3]
        assert np.trace(turn) > 1.0 + 2.0 * np.cos(0.02)

    def dropped(self, reason: str) -> int:
        return self.node.health._drops[reason]


def test_odd_detections_are_counted_and_good_ones_tell_the_pose(
    graph: Any, rng: np.random.Generator
) -> None:
    stage, pose = Stage(graph), seen_from(BOARD, 1.0, 0.5, rng)
    poses = [make_transform(np.eye(3), (0.0, 0.0, 0.06 * i)) @ pose for i in range(5)]
    first = stage.look(1, poses[0])
    stage.publish(stage.detect(1, poses[0], rng))
    stage.check(first, poses[0])

    odd = {}
    odd["wrong frame"] = stage.detect(2, poses[1], rng)
    odd["wrong frame"].header.frame_id = "another_camera"
    odd["malformed message"] = stage.detect(3, poses[2], rng)
    odd["malformed message"].detections[0].corners[2].x = float("nan")
    odd["tag with corners in another order"] = stage.detect(4, poses[3], rng)
    for tag in odd["tag with corners in another order"].detections:
        tag.corners = tag.corners[::-1]
    for number, (reason, message) in enumerate(odd.items(), start=2):
        stage.look(number, poses[number - 1])
        stage.publish(message)
        graph.spin_until(partial(stage.dropped, reason), f"the drop of {reason}")
    last = stage.look(5, poses[4])
    stage.publish(stage.detect(5, poses[4], rng))
    stage.check(last, poses[4])
    assert {reason: stage.dropped(reason) for reason in odd} == {
        "wrong frame": 1,
        "malformed message": 1,
        "tag with corners in another order": 4,
    }


def test_a_detector_that_comes_late_or_ends_does_not_hold_the_camera_up(
    graph: Any, rng: np.random.Generator
) -> None:
    stage, pose = Stage(graph), seen_from(BOARD, 1.0, 0.5, rng)
    for number in range(1, 5):
        stage.look(number, pose)

    def looked_at() -> int:
        return int(stage.node.health.values().get("stamp", 0))

    graph.spin_until(lambda: looked_at() >= 3 * STEP, "views that go on")
    assert not stage.poses
    stage.publish(stage.detect(2, pose, rng))
    graph.spin_until(lambda: stage.dropped("tags after their image"), "the late one")
    stage.look(5, pose)
    stage.publish(stage.detect(5, pose, rng))
    stage.check(5 * STEP, pose)
    for number in range(6, 12):
        stage.look(number, pose)
    graph.spin_until(lambda: looked_at() >= 11 * STEP, "views that go on again")
