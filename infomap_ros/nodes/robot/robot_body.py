"""The robot's own body, as map_fusion keeps it out of the map."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

from sensor_msgs.msg import JointState
from std_msgs.msg import String

from infomap_ros.geometry.config import check_config, parameter
from infomap_ros.messages import decode_joint_state, decode_text
from infomap_ros.motion.robot.description_config import DescriptionConfig
from infomap_ros.nodes.common import qos
from infomap_ros.nodes.common.base import MonitoredNode
from infomap_ros.pipeline.robot_body import RobotBody


@dataclass(frozen=True)
class RobotBodyConfig:
    """Whether the robot's own body is removed.

    Raises:
        ConfigError: a value is out of its range.
    """

    remove_body: bool = parameter(
        True,
        "Drop points on the robot's own body. Needs robot_description and, if it has joints, "
        "joint_states; before the first robot_description nothing is dropped.",
    )
    robot: DescriptionConfig = field(default_factory=DescriptionConfig)

    def __post_init__(self) -> None:
        check_config(self)


def listen_to_body(node: MonitoredNode, body: RobotBody, on_news: Callable[[], None]) -> None:
    """Listen to robot_description and joint_states, where the body is to be removed.

    Args:
        node: has the configuration of the body.
        body: is told of them.
        on_news: called when more is known of the body than before.
    """
    config = node.config(RobotBodyConfig)

    def on_description(message: String) -> None:
        body.robot = config.robot.read(decode_text(message).text)
        node.get_logger().info(f"removing the body of robot '{body.robot.name}' from clouds")

    def on_joints(message: JointState) -> None:
        body.add(decode_joint_state(message))
        on_news()

    if config.remove_body:
        latched, stream = qos.latched(), qos.sensor_data(100)
        node.listen(String, "robot_description", on_description, latched, required=False)
        node.listen(JointState, "joint_states", on_joints, stream, required=False)
