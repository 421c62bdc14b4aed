"""``infomap doctor``: look at a live graph for a while and say what it lacks.

What can be wrong with the data of a live graph: checks on records, without ROS.
"""

from __future__ import annotations

import argparse
import time
from collections import defaultdict, deque
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import QoSCompatibility, qos_check_compatible

from infomap_ros.errors import CalibrationError, InfomapError
from infomap_ros.geometry import (
    CameraCalibration,
    CameraInfoRecord,
    ImageRecord,
    PoseRecord,
    Record,
    rig_from_calibrations,
)
from infomap_ros.messages import (
    CAMERA_INFO,
    COMPRESSED_IMAGE,
    IMAGE,
    JOINT_STATE,
    ODOMETRY,
    POINT_CLOUD,
    POSE_WITH_COVARIANCE,
    STRING,
    decode,
)
from infomap_ros.nodes.common import qos
from infomap_ros.nodes.common.message_types import message_class
from infomap_ros.nodes.robot.image_inputs import is_compressed

_LEAST_MATCHES = 30
_ROW_TOLERANCE = 1.0  # [px]


@dataclass(frozen=True)
class Finding:
    """One thing that was looked at.

    Attributes:
        good: whether it is as it should be.
        subject: what was looked at, mostly a topic.
        text: what was found and, if it is not good, what to do.
    """

    good: bool
    subject: str
    text: str


def check_size(topic: str, image: ImageRecord, info: CameraInfoRecord) -> Finding:
    """Does the calibration fit the size of the image?"""
    height, width = image.pixels.shape[:2]
    expected = (info.calibration.width, info.calibration.height)
    if (width, height) == expected:
        return Finding(True, topic, f"{width}x{height} px, as calibrated")
    text = f"image is {width}x{height} px, calibration is for {expected[0]}x{expected[1]} px"
    return Finding(False, topic, text + ": calibrate at this size or scale the camera info")


def check_frames(topic: str, record: Record, other_topic: str, other: Record) -> Finding:
    """Do two topics that belong together name the same frame?"""
    if record.frame_id and record.frame_id == other.frame_id:
        return Finding(True, topic, f"frame '{record.frame_id}', as {other_topic}")
    text = f"frame '{record.frame_id}', but {other_topic} has '{other.frame_id}'"
    return Finding(False, topic, text + ": both must name the same optical frame")


def check_frame(topic: str, record: Record, expected: str) -> Finding:
    """Is the data in the frame in which it must be?"""
    if record.frame_id == expected:
        return Finding(True, topic, f"frame '{expected}'")
    return Finding(False, topic, f"frame '{record.frame_id}', expected '{expected}'")


def check_rig(topic: str, left: CameraCalibration, right: CameraCalibration) -> Finding:
    """Do the two calibrations make a stereo rig?"""
    try:
        rig = rig_from_calibrations(left, right)
    except CalibrationError as error:
        return Finding(False, topic, str(error))
    return Finding(True, topic, f"baseline {rig.baseline:.4f} m, focal length {rig.left.fx:.1f} px")


def check_rows(topic: str, left: ImageRecord, right: ImageRecord) -> Finding:
    """Are the rows of a pair aligned, as rectified images have them?"""
    offset = row_offset(_gray(left), _gray(right))
    if offset is None:
        return Finding(True, topic, "too little texture to tell whether rows are aligned")
    if offset <= _ROW_TOLERANCE:
        return Finding(True, topic, f"rows are aligned within {offset:.2f} px")
    text = f"rows of left and right differ by {offset:.1f} px: the images are not rectified"
    return Finding(
        False, topic, text + " (publish *_raw and start stereo_range with rectify:=true)"
    )


def check_distortion(topic: str, info: CameraInfoRecord) -> Finding:
    """Can raw images be rectified with this calibration?"""
    calibration = info.calibration
    if calibration.projection[0, 0] == 0.0 or calibration.intrinsics[0, 0] == 0.0:
        return Finding(False, topic, "is not calibrated (K or P is zero): run camera calibration")
    return Finding(True, topic, f"calibrated ({calibration.distortion_model or 'no'} distortion)")


def check_stamps(topic: str, stamps: Iterable[int], poses: Iterable[PoseRecord]) -> Finding:
    """Is there a pose at the stamps of the data?

    Args:
        topic: of the poses.
        stamps: of the data [ns].
        poses: that came meanwhile.
    """
    known = np.array(sorted(pose.stamp for pose in poses), dtype=np.int64)
    wanted = np.array(sorted(stamps), dtype=np.int64)
    if not len(known):
        return Finding(False, topic, "no pose came")
    if not len(wanted):
        return Finding(True, topic, f"{len(known)} poses, no data to compare with")
    inside = wanted[(wanted >= known[0]) & (wanted <= known[-1])]
    if not len(inside):
        gap = min(abs(float(w - k)) for w in (wanted[0], wanted[-1]) for k in (known[0], known[-1]))
        text = f"no pose at the stamps of the data, the nearest is {gap * 1e-9:.3f} s away"
        return Finding(False, topic, text + ": clocks differ, or use_sim_time is not the same")
    exact = int(np.isin(inside, known).sum())
    return Finding(True, topic, f"{exact} of {len(inside)} stamps have a pose of their own")


def row_offset(left: np.ndarray, right: np.ndarray) -> float | None:
    """Typical distance of matching features across rows.

    Args:
        left: shape (H, W), uint8.
        right: shape (H, W), uint8.

    Returns:
        Median absolute difference of rows [px]; None where too few features match.
    """
    detector = cv2.ORB.create(1000)
    points_left, words_left = detector.detectAndCompute(left, None)
    points_right, words_right = detector.detectAndCompute(right, None)
    if words_left is None or words_right is None:
        return None
    matches = cv2.BFMatcher(cv2.NORM_HAMMING, crossCheck=True).match(words_left, words_right)
    matches = [match for match in matches if match.distance < 40]
    if len(matches) < _LEAST_MATCHES:
        return None
    rows = [points_left[m.queryIdx].pt[1] - points_right[m.trainIdx].pt[1] for m in matches]
    return float(np.median(np.abs(rows)))


def _gray(image: ImageRecord) -> np.ndarray:
    pixels = np.asarray(image.pixels)
    if pixels.dtype != np.uint8:
        top = float(pixels.max()) or 1.0
        pixels = (pixels.astype(np.float32) * (255.0 / top)).astype(np.uint8)
    return pixels if pixels.ndim == 2 else pixels[..., :3].mean(axis=-1).astype(np.uint8)


def check_localization(name: str, values: Mapping[str, str]) -> Finding:
    """Whether the camera is located.

    Args:
        name: of the node that says so.
        values: state, reason, and how many fiducials are tracked.
    """
    state, reason = values["state"], values.get("reason", "")
    text = f"{state}, {values['fiducials tracked']} fiducials tracked"
    return Finding(state in ("tracking", "coasting"), name, f"{text}: {reason}" if reason else text)


def similar_topics(node: Node, topic: str, type_name: str) -> list[str]:
    """Published topics that may be what is missing, the likeliest first.

    Args:
        node: through which the graph is seen.
        topic: relative name of what is missing, for example ``left/image_rect``.
        type_name: its type.
    """
    full = node.resolve_topic_name(topic)
    side, _, tail = topic.rpartition("/")
    found = [
        name
        for name, types in node.get_topic_names_and_types()
        if type_name in types and name != full and side in name and node.count_publishers(name)
    ]
    return sorted(found, key=lambda name: (tail not in name, name))


def unconnected(node: Node) -> list[Finding]:
    """Publishers and subscribers of one topic whose quality of service keeps them apart.

    Args:
        node: through which the graph is seen.
    """
    found = []
    for name, _ in node.get_topic_names_and_types():
        for publisher in node.get_publishers_info_by_topic(name):
            for subscriber in node.get_subscriptions_info_by_topic(name):
                profiles = publisher.qos_profile, subscriber.qos_profile
                verdict, reason = qos_check_compatible(*profiles)
                if verdict == QoSCompatibility.ERROR:
                    pair = f"{publisher.node_name} -> {subscriber.node_name}"
                    found.append(Finding(False, name, f"{pair} never connect: {reason}"))
    return found


REQUIRED = {
    "left/camera_info": CAMERA_INFO,
    "right/camera_info": CAMERA_INFO,
    "camera_pose": POSE_WITH_COVARIANCE,
}
OPTIONAL = {
    "points2": POINT_CLOUD,
    "joint_states": JOINT_STATE,
    "odom": ODOMETRY,
    "robot_description": STRING,
}
_KEPT = 200  # records of each topic


class Doctor(Node):
    """Listens to everything that the nodes which make a map need, and to what they say themselves.

    Args:
        raw: look at image_raw instead of image_rect.
        node_arguments: passed on to `rclpy.node.Node`.
    """

    def __init__(self, raw: bool, **node_arguments: Any) -> None:
        super().__init__("infomap_doctor", **node_arguments)
        kind = "image_raw" if raw else "image_rect"
        self.raw = raw
        self.images = (f"left/{kind}", f"right/{kind}")
        self.topics = {topic: self._image_type(topic) for topic in self.images}
        self.topics |= REQUIRED | OPTIONAL
        self.records: dict[str, deque[Record]] = defaultdict(lambda: deque(maxlen=_KEPT))
        self.errors: dict[str, str] = {}
        self.conditions: dict[str, DiagnosticStatus] = {}
        self._listening: set[str] = set()
        self.create_subscription(
            DiagnosticArray, "/diagnostics", self._on_diagnostics, qos.stream(depth=50)
        )

    def _image_type(self, topic: str) -> str:
        """Of an image topic, by the name to which it is remapped."""
        return COMPRESSED_IMAGE if is_compressed(self.resolve_topic_name(topic)) else IMAGE

    def listen_to_all(self) -> None:
        """Subscribe to what is published by now, with the durability on offer."""
        for topic, type_name in self.topics.items():
            publishers = self.get_publishers_info_by_topic(self.resolve_topic_name(topic))
            if topic in self._listening or not publishers:
                continue
            self._listening.add(topic)
            profile = qos.sensor_data(depth=20)
            if all(p.qos_profile.durability == qos.latched().durability for p in publishers):
                profile = qos.latched()
            receive = self._receiver(topic, type_name)
            self.create_subscription(message_class(type_name), topic, receive, profile)

    def _receiver(self, topic: str, type_name: str) -> Callable[[Any], None]:
        def receive(message: Any) -> None:
            try:
                self.records[topic].extend(decode(type_name, message))
            except InfomapError as error:
                self.errors[topic] = str(error)

        return receive

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        for status in message.status:
            self.conditions[status.hardware_id] = status

    def examine(self) -> list[Finding]:
        """What was found so far."""
        found = [self._presence(topic) for topic in self.topics]
        found += [Finding(False, self._full(t), text) for t, text in self.errors.items()]
        found += self._cameras() + self._poses() + self._localization() + unconnected(self)
        return found

    def _full(self, topic: str) -> str:
        return str(self.resolve_topic_name(topic))

    def _presence(self, topic: str) -> Finding:
        name, count = self._full(topic), len(self.records[topic])
        if count:
            return Finding(True, name, f"{count}{'+' if count == _KEPT else ''} messages")
        if topic in self.errors:
            return Finding(False, name, "its messages cannot be read")
        if self.count_publishers(name):
            return Finding(topic in OPTIONAL, name, "has a publisher, but no message came")
        if topic in OPTIONAL:
            return Finding(True, name, "optional, and not published")
        return Finding(False, name, "nobody publishes it" + self._hint(topic))

    def _hint(self, topic: str) -> str:
        raw = topic.replace("image_rect", "image_raw")
        if raw != topic and self.count_publishers(self._full(raw)):
            return f", but {raw} is there: start stereo_range with rectify:=true, look with --raw"
        others = similar_topics(self, topic, self.topics[topic])
        if topic == "camera_pose" and not others:
            return ": start fiducial_localization, or dead_reckoning on a robot with odometry alone"
        return f"; remap it: -r {topic}:={others[0]}" if others else ""

    def _localization(self) -> list[Finding]:
        """What a node that locates the camera says of its pose."""
        found = []
        for name, status in self.conditions.items():
            values = {pair.key: pair.value for pair in status.values}
            if "state" in values and "fiducials tracked" in values:
                found.append(check_localization(name, values))
        return found

    def _last(self, topic: str) -> Any:
        return self.records[topic][-1] if self.records[topic] else None

    def _cameras(self) -> list[Finding]:
        found = []
        for image_topic, side in zip(self.images, ("left", "right"), strict=True):
            info_topic = f"{side}/camera_info"
            image, info = self._last(image_topic), self._last(info_topic)
            if info is not None:
                found.append(check_distortion(self._full(info_topic), info))
            if image is not None and info is not None:
                name = self._full(image_topic)
                found.append(check_size(name, image, info))
                found.append(check_frames(name, image, self._full(info_topic), info))
        left, right = self._last("left/camera_info"), self._last("right/camera_info")
        if left is not None and right is not None:
            name = self._full("right/camera_info")
            found.append(check_rig(name, left.calibration, right.calibration))
        return found + self._pairs()

    def _pairs(self) -> list[Finding]:
        left, right = ({r.stamp: r for r in self.records[topic]} for topic in self.images)
        if not left or not right:
            return []
        name, shared = self._full(self.images[1]), sorted(left.keys() & right.keys())
        if not shared:
            text = "no stamp of the left images is among those of the right ones"
            return [Finding(False, name, text + " (set pairing_tolerance)")]
        if self.raw:
            return [Finding(True, name, f"{len(shared)} pairs with equal stamps")]
        pair: Any = left[shared[-1]], right[shared[-1]]
        return [check_rows(name, *pair)]

    def _poses(self) -> list[Finding]:
        name, poses = self._full("camera_pose"), list(self.records["camera_pose"])
        stamps = [r.stamp for r in self.records["points2"] or self.records[self.images[0]]]
        found = [check_stamps(name, stamps, poses)] if poses else []  # type: ignore[arg-type]
        cloud, image = self._last("points2"), self._last(self.images[0])
        if cloud is not None and image is not None:
            name = self._full("points2")
            found.append(check_frame(name, cloud, image.frame_id))
        return found


def examine_graph(
    seconds: float = 5.0, raw: bool = False, arguments: Sequence[str] | None = None
) -> list[Finding]:
    """Listen to the graph for a while and say what is there and what is not.

    Args:
        seconds: how long to listen [s].
        raw: the images are image_raw, to be rectified.
        arguments: ROS arguments, for example ``["--ros-args", "-r", "__ns:=/robot1"]``.
    """
    context = rclpy.Context()
    rclpy.init(args=list(arguments or []), context=context)
    node = Doctor(raw, context=context)
    executor = SingleThreadedExecutor(context=context)
    executor.add_node(node)
    try:
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            node.listen_to_all()
            executor.spin_once(timeout_sec=0.1)
        return node.examine()
    finally:
        node.destroy_node()
        context.try_shutdown()


def main(arguments: Sequence[str] | None = None) -> int:
    """Command line of the doctor; returns 1 when something is wrong."""
    parser = argparse.ArgumentParser(
        prog="infomap doctor", description=__doc__, epilog="Example: infomap doctor --seconds 10"
    )
    parser.add_argument("--seconds", type=float, default=5.0, help="how long to listen")
    parser.add_argument("--raw", action="store_true", help="the images are image_raw")
    options, ros_arguments = parser.parse_known_args(arguments)
    found = examine_graph(options.seconds, options.raw, ros_arguments)
    for finding in sorted(found, key=lambda finding: finding.good):
        print(f"{'ok   ' if finding.good else 'WRONG'} {finding.subject}: {finding.text}")
    wrong = sum(not finding.good for finding in found)
    print(f"{wrong} of {len(found)} checks failed" if wrong else "all is well")
    return 1 if wrong else 0


if __name__ == "__main__":
    raise SystemExit(main())
