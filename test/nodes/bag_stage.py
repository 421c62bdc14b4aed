"""A recorded bag, played to nodes of a test graph pair by pair, each waited for."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

from geometry_msgs.msg import PoseWithCovarianceStamped
from nav_msgs.msg import Odometry
from rclpy.qos import DurabilityPolicy, QoSProfile
from sensor_msgs.msg import CameraInfo, Image, JointState
from std_msgs.msg import String

from infomap_ros.geometry import PoseRecord
from infomap_ros.geometry.resources import find_share
from infomap_ros.messages import decode_pose_with_covariance, encode
from infomap_ros.nodes.common.message_types import RclpyMessageTypes
from infomap_ros.replay.bags.reader import BagReader

TYPES = RclpyMessageTypes()
IMAGES = ("/left/image_raw", "/right/image_raw")
INFOS = ("/left/camera_info", "/right/camera_info")
MOTION = ("/odom", "/joint_states", "/robot_description")
TRUTH = "/ground_truth/camera_pose"
_KINDS = {
    **dict.fromkeys(IMAGES, Image),
    **dict.fromkeys(INFOS, CameraInfo),
    "/odom": Odometry,
    "/joint_states": JointState,
    "/robot_description": String,
}


class BagStage:
    """Publishes the shipped bag, or a part of it.

    Args:
        graph: of the test.
        topics: of the bag that are played.
    """

    def __init__(self, graph: Any, topics: tuple[str, ...] = IMAGES + INFOS + MOTION) -> None:
        self.graph = graph
        self.poses: dict[int, PoseRecord] = {}
        self.truth: dict[int, Any] = {}
        latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self._publishers = {
            topic: graph.tester.create_publisher(
                _KINDS[topic],
                topic.lstrip("/"),
                latched if topic == "/robot_description" else QoSProfile(depth=100),
            )
            for topic in topics
        }
        graph.tester.create_subscription(
            PoseWithCovarianceStamped, "camera_pose", self._on_pose, QoSProfile(depth=100)
        )

    def connect(self) -> None:
        """Wait for the node's subscriptions and publisher."""
        self.graph.connect(*self._publishers.values())
        topic = self.graph.tester.resolve_topic_name("camera_pose")
        self.graph.spin_until(lambda: self.graph.tester.count_publishers(topic), "camera_pose")

    def play(self, pairs: int, first: int = 0, shift: int = 0) -> Iterator[int]:
        """Publish pair by pair; yields the stamp of each, after half a second of what follows it.

        Args:
            pairs: how many.
            first: how many are left out.
            shift: added to all stamps [ns].
        """
        wanted = (*self._publishers, TRUTH)
        with BagReader(find_share("bags/rover_rocks")) as bag:
            pending: list[int] = []
            number = 0
            for entry in bag.records(wanted):
                stamp = entry.record.stamp + shift
                if entry.topic == TRUTH:
                    self.truth[stamp] = entry.record.transform
                    continue
                while pending and stamp > pending[0] + 100_000_000:
                    yield pending.pop(0)
                if entry.topic in IMAGES:
                    number += entry.topic == IMAGES[0]
                    if not first < number <= first + pairs:
                        continue
                    if entry.topic == IMAGES[1]:
                        pending.append(stamp)
                self._publish(entry.topic, entry.record, stamp)
                if number > first + pairs:
                    break
            yield from pending

    def located(self, stamp: int, node: Any) -> PoseRecord | None:
        """Wait until a node has looked at the pair of a stamp; its pose, None where it is lost."""

        def done() -> bool:
            told = node.health.values()
            return told.get("stamp") == str(stamp) and told["state"] in ("lost", "searching")

        self.graph.spin_until(lambda: stamp in self.poses or done(), f"the pair at {stamp}", 60.0)
        return self.poses.get(stamp)

    def _publish(self, topic: str, record: Any, stamp: int) -> None:
        if hasattr(record, "stamp"):
            record = replace(record, stamp=stamp)
        self._publishers[topic].publish(encode(TYPES, record))

    def _on_pose(self, message: PoseWithCovarianceStamped) -> None:
        pose = decode_pose_with_covariance(message)
        self.poses[pose.stamp] = pose
