"""What the simulated robot publishes: sensors as hardware would, and the truth beside them."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from typing import Any, ClassVar

import numpy as np
from geometry_msgs.msg import PoseWithCovarianceStamped
from nav_msgs.msg import Odometry
from rclpy.publisher import Publisher
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import CameraInfo, Image, JointState
from std_msgs.msg import String

from infomap_ros.geometry import (
    CameraInfoRecord,
    ImageRecord,
    JointStateRecord,
    OdometryRecord,
    PoseRecord,
    Record,
    TextRecord,
    TransformRecord,
    invert_transform,
)
from infomap_ros.geometry.config import check_config, parameter, setting
from infomap_ros.messages import (
    TF,
    encode,
    encode_camera_info,
    encode_clock,
    encode_image,
    encode_joint_state,
    encode_pose,
    encode_text,
    encode_transforms,
)
from infomap_ros.nodes.common import qos
from infomap_ros.nodes.common.base import MonitoredNode
from infomap_ros.nodes.common.message_types import RclpyMessageTypes, message_class
from infomap_ros.simulation.body.robot import fixed_frames, moving_frames
from infomap_ros.simulation.sensor_schedule import (
    SIDES,
    Periodic,
    SensorSchedule,
    SensorScheduleConfig,
)
from infomap_ros.simulation.simulator import Simulator


class SimulatorFrames:
    """Publishes /tf and /tf_static; without tf2_msgs it says so once and publishes nothing.

    Args:
        node: that publishes.
        simulator: the robot.
    """

    def __init__(self, node: MonitoredNode, simulator: Simulator) -> None:
        self._simulator, self._types = simulator, RclpyMessageTypes()
        self._moving = moving_frames(simulator.description)
        self._publisher = None
        try:
            kind = message_class(TF)
        except ModuleNotFoundError:
            node.get_logger().warning("no /tf: tf2_msgs is not installed")
            return
        self._publisher = node.advertise(kind, "/tf", qos.stream(depth=100))
        self._static = node.advertise(kind, "/tf_static", qos.latched())
        edges = [replace(e, stamp=simulator.stamp) for e in fixed_frames(simulator.description)]
        self._static.publish(encode_transforms(self._types, edges))

    def publish(self, odometry: OdometryRecord) -> None:
        """Publish odom and the links that joints move, at the stamp of the odometry."""
        if self._publisher is None:
            return
        stamp, simulator = odometry.stamp, self._simulator
        edges = [
            TransformRecord(stamp, odometry.frame_id, odometry.child_frame_id, odometry.transform)
        ]
        for parent, child in self._moving:
            T_parent_child = invert_transform(simulator.frame(parent)) @ simulator.frame(child)
            edges.append(TransformRecord(stamp, parent, child, T_parent_child))
        self._publisher.publish(encode_transforms(self._types, edges))


_POSE = PoseWithCovarianceStamped


@dataclass(frozen=True)
class SimulatorOutputsConfig:
    """What is published besides what the sensors measure.

    Raises:
        ConfigError: a value is out of its range.
    """

    map_frame: str = parameter("map", "Name of the frame of the world.")
    publish_clock: bool = setting(
        True, "Publish /clock. Of several robots in one world only one may."
    )
    clock_rate: ClassVar[float] = 50.0
    """Rate of /clock [Hz]."""
    range_source: str = parameter(
        "stereo",
        "What the robot sees with: a raw stereo pair, or a depth camera on depth/image_rect.",
        choices=("stereo", "depth", "both"),
    )
    publish_tf: bool = parameter(
        True, "Publish /tf and /tf_static, where tf2_msgs is installed: odom and all links."
    )

    def __post_init__(self) -> None:
        check_config(self)


class SimulatorOutputs:
    """The publishers of the simulator; to be used from the thread that simulates.

    Args:
        node: that publishes.
        simulator: what is published.
        scene: description of the world, for ground_truth/scene.

    Attributes:
        has_measured: whether something was due at the last look.
    """

    def __init__(self, node: MonitoredNode, simulator: Simulator, scene: str) -> None:
        self._node, self._simulator, self._scene = node, simulator, scene
        config = self._config = node.config(SimulatorOutputsConfig)
        self._types = RclpyMessageTypes()
        sensors = node.config(SensorScheduleConfig)
        self._sensors = SensorSchedule(simulator, sensors, config.map_frame)
        self._clock_due, stream, pose = Periodic(config.clock_rate), qos.stream, _POSE
        self._clock = (
            node.advertise(Clock, "/clock", stream(depth=1)) if config.publish_clock else None
        )
        self._measured = {
            "joint_states": node.advertise(JointState, "joint_states", stream(depth=50)),
            "odom": node.advertise(Odometry, "odom", stream(depth=50)),
        }
        if sensors.publish_camera_pose:
            self._measured["camera_pose"] = node.advertise(pose, "camera_pose", stream(depth=50))
        self._true_camera = node.advertise(pose, "ground_truth/camera_pose", stream())
        self._true_base = node.advertise(pose, "ground_truth/base_pose", stream())
        self._true_joints = node.advertise(JointState, "ground_truth/joint_states", stream())
        self._images = {
            f"{side}/image_raw": node.advertise(Image, f"{side}/image_raw", stream(depth=5))
            for side in SIDES
        }
        for side in SIDES:
            topic = f"{side}/camera_info"
            self._measured[topic] = node.advertise(CameraInfo, topic, stream(depth=5))
        self._depth = None
        if self._config.range_source != "stereo":
            self._depth = (
                node.advertise(Image, "depth/image_rect", stream(depth=5)),
                node.advertise(CameraInfo, "depth/camera_info", stream(depth=5)),
            )
        self._latched = {
            topic: node.advertise(String, topic, qos.latched())
            for topic in ("robot_description", "ground_truth/scene", "ground_truth/contacts")
        }
        self._frames = SimulatorFrames(node, simulator) if self._config.publish_tf else None
        self._contacts, self.has_measured = -1, False

    def begin(self) -> None:
        """Publish what does not change."""
        self._publish_text("robot_description", self._simulator.description)
        self._publish_text("ground_truth/scene", self._scene)

    def publish_due(self) -> None:
        """Publish what is due by now, with the present stamp.

        Raises:
            SimulationError: this machine cannot draw images.
        """
        due = self._sensors.due()
        self.has_measured = due.state
        if self._clock is not None and (self._clock_due.is_due(self._simulator.time) or due.image):
            self._clock.publish(encode_clock(self._types, self._simulator.stamp))
        if due.state:
            self.publish_state()
        if due.image:
            self._publish_pair()
            self._publish_depth()
        self._publish_contacts()

    def publish_state(self) -> None:
        """Publish what joints and odometry measure now, and the truth."""
        simulator, types = self._simulator, self._types
        stamp, world = simulator.stamp, self._config.map_frame
        measured = dict(self._sensors.state())
        self._publish(measured)
        for publisher, truth in (
            (self._true_camera, simulator.true_camera_pose()),
            (self._true_base, simulator.true_pose()),
        ):
            publisher.publish(encode_pose(types, PoseRecord(stamp, world, truth)))
        joints = simulator.true_joints()
        angles = np.array(list(joints.values()))
        record = JointStateRecord(stamp, "", tuple(joints), angles)
        self._true_joints.publish(encode_joint_state(types, record))
        odometry = measured["odom"]
        if self._frames is not None and isinstance(odometry, OdometryRecord):
            self._frames.publish(odometry)

    def _publish(self, measured: Mapping[str, Record]) -> None:
        for topic, record in measured.items():
            self._measured[topic].publish(encode(self._types, record))

    def _publish_pair(self) -> None:
        """Camera infos always, as others take their stamps; images where somebody listens."""
        self._publish(dict(self._sensors.camera_infos()))
        wanted = self._config.range_source != "depth"
        if wanted and any(image.get_subscription_count() for image in self._images.values()):
            for topic, record in self._sensors.pair():
                self._images[topic].publish(encode(self._types, record))
            self._node.health.produced()

    def _publish_depth(self) -> None:
        if self._depth is None:
            return
        images, infos = self._depth
        simulator, frame = self._simulator, self._simulator.camera_frames[0]
        info = CameraInfoRecord(simulator.stamp, frame, simulator.depth_calibration)
        infos.publish(encode_camera_info(self._types, info))
        if images.get_subscription_count():
            taken = simulator.capture_depth()
            record = ImageRecord(taken.stamp, frame, taken.depth, "32FC1")
            images.publish(encode_image(self._types, record))
            self._node.health.produced()

    def _publish_contacts(self) -> None:
        """Tell every new forbidden contact, as JSON; those before a restart count as well."""
        count, events = self._simulator.contacts, self._simulator.contact_events
        if count == self._contacts:
            return
        self._contacts = count
        content: dict[str, Any] = {"count": count}
        if events:
            content["last"] = asdict(events[-1])
            self._node.get_logger().warning(f"contact: {events[-1].link} and {events[-1].other}")
        self._node.health.note("forbidden contacts", str(count))
        self._publish_text("ground_truth/contacts", json.dumps(content))

    def _publish_text(self, topic: str, text: str) -> None:
        publisher: Publisher = self._latched[topic]
        publisher.publish(encode_text(self._types, TextRecord(self._simulator.stamp, "", text)))
