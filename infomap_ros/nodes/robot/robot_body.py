"""The robot's own body, as map_fusion keeps it out of the map."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from sensor_msgs.msg import JointState
from std_msgs.msg import String

from infomap_ros.exploration.team.bodies_in_scan import BodyInScan, on_bodies
from infomap_ros.geometry import PlacedSolid, PointCloudRecord
from infomap_ros.geometry.config import check_config, parameter
from infomap_ros.geometry.joint_buffer import JointBuffer, JointBufferConfig
from infomap_ros.mapping.scans.body import BodyFilterConfig, body_mask
from infomap_ros.messages import decode_joint_state, decode_text
from infomap_ros.motion import RobotModel
from infomap_ros.motion.robot.description_config import DescriptionConfig
from infomap_ros.nodes.common import qos
from infomap_ros.nodes.common.base import MonitoredNode
from infomap_ros.nodes.common.clock_jumps import JumpingBuffer


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


class RobotBody:
    """Listens to robot_description and joint_states, and knows where the body is.

    Args:
        node: has the configurations of body and joint buffer.
        on_news: called when more is known of the body than before.

    Attributes:
        newest_stamp: of the last joint state [ns].
    """

    def __init__(self, node: MonitoredNode, on_news: Callable[[], None]) -> None:
        self._on_news = on_news
        config = node.config(JointBufferConfig)
        self._joints = JumpingBuffer(lambda: JointBuffer(config), round(config.max_gap * 1e9))
        self._robot: RobotModel | None = None
        self.newest_stamp = 0
        self._log = node.get_logger()
        self._reading = node.config(RobotBodyConfig).robot
        if node.config(RobotBodyConfig).remove_body:
            node.listen(
                String, "robot_description", self._on_description, qos.latched(), required=False
            )
            node.listen(
                JointState, "joint_states", self._on_joints, qos.sensor_data(100), required=False
            )

    def check_known_at(self, stamp: int) -> None:
        """Make sure that the place of the body at a time is known.

        Args:
            stamp: [ns].

        Raises:
            PoseUnavailableError: joint positions are not known at that time.
        """
        if self._robot is not None and self._robot.joints:
            self._joints.at(stamp)

    def solids_in(self, frame: str, stamp: int) -> list[PlacedSolid]:
        """The body's solids at a time, placed in a frame; none before there is a description.

        Args:
            frame: optical frame of the camera.
            stamp: [ns].

        Raises:
            RobotModelError: the description lacks the frame, or a joint has no position.
            PoseUnavailableError: joint positions are not known at that time.
        """
        if self._robot is None:
            return []
        positions = self._joints.at(stamp) if self._robot.joints else {}
        return self._robot.solids_in(frame, positions)

    def clouds_have_jumped(self, stamp: int) -> None:
        """The clock of the clouds has jumped back to `stamp` [ns]."""
        self._joints.others_have_jumped(stamp)

    def _on_description(self, message: String) -> None:
        self._robot = self._reading.read(decode_text(message).text)
        self._log.info(f"removing the body of robot '{self._robot.name}' from clouds")

    def _on_joints(self, message: JointState) -> None:
        record = decode_joint_state(message)
        self._joints.add(record)
        self.newest_stamp = record.stamp
        self._on_news()


def without_bodies(
    cloud: PointCloudRecord,
    body: Sequence[PlacedSolid],
    teammates: Sequence[BodyInScan],
    config: BodyFilterConfig,
) -> PointCloudRecord:
    """The cloud without the points that may lie on a robot: they become NaN.

    Args:
        cloud: in the frame in which the bodies are placed.
        body: the robot's own solids.
        teammates: bodies of the others.
        config: how far they are grown.
    """
    if not body and not teammates:
        return cloud
    on_body = body_mask(cloud.points, cloud.covariances, body, config)
    on_body |= on_bodies(cloud.points, cloud.covariances, teammates, config)
    if not on_body.any():
        return cloud
    points = cloud.points.copy()
    points[on_body] = np.nan
    return replace(cloud, points=points)
