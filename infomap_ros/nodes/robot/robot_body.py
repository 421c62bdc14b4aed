"""The robot's own body, as map_fusion keeps it out of the map."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field

from sensor_msgs.msg import JointState

from infomap_ros.geometry.config import check_config, parameter
from infomap_ros.messages import decode_joint_state
from infomap_ros.motion.robot.robot_model import DescriptionConfig
from infomap_ros.nodes.common import qos
from infomap_ros.nodes.common.base import MonitoredNode
from infomap_ros.nodes.robot.description_listener import DescriptionListener, warn_of_left_out
from infomap_ros.pipeline.robot_body import RobotBody

_DISCOVERY = 3.0  # [s], in which publishers find each other


@dataclass(frozen=True)
class RobotBodyConfig:
    """Whether the robot's own body is removed.

    Raises:
        ConfigError: a value is out of its range.
    """

    remove_body: bool = parameter(
        True,
        "Drop points on the robot's own body. Needs robot_description and, if it has joints, "
        "joint_states; where these are missing, nothing is dropped, with a warning.",
    )
    frame_prefix: str = parameter(
        "",
        "Put before the names of the links of robot_description, as robot_state_publisher's "
        "parameter of this name.",
    )
    robot: DescriptionConfig = field(default_factory=DescriptionConfig)

    def __post_init__(self) -> None:
        check_config(self)


class BodyListener:
    """Listens to robot_description and joint_states, and to /tf_static for the camera's frame.

    Args:
        node: has the configuration of the body.
        body: gets them.
        on_change: called when more is known of the body than before.
    """

    def __init__(self, node: MonitoredNode, body: RobotBody, on_change: Callable[[], None]) -> None:
        self._node, self._body, self._on_change = node, body, on_change
        self._config = node.config(RobotBodyConfig)
        self._since = time.monotonic()
        prefix, stream = self._config.frame_prefix, qos.sensor_data(100)
        self._texts = DescriptionListener(node, self._on_description, prefix, required=False)
        node.listen(JointState, "joint_states", self._on_joints, stream, required=False)

    @property
    def are_joints_sent(self) -> bool:
        """Whether somebody publishes joint states, or may be found to do so."""
        topic = self._node.resolve_topic_name("joint_states")
        is_early = time.monotonic() < self._since + _DISCOVERY
        return is_early or self._node.count_publishers(topic) > 0

    def look_from(self, camera_frame: str) -> None:
        """Set in which frame clouds are."""
        self._texts.want(camera_frame)

    def _on_description(self, text: str) -> None:
        self._since = time.monotonic()
        self._body.robot = robot = self._config.robot.read(text)
        log = self._node.get_logger()
        log.info(f"removing the body of robot '{robot.name}' from clouds")
        warn_of_left_out(log, robot)

    def _on_joints(self, message: JointState) -> None:
        joints = decode_joint_state(message)
        self._node.health.note_joints(joints.names)
        self._body.add(joints)
        self._on_change()
