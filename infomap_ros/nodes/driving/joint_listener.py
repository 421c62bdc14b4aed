"""Where the joints are, how fast, and how far and fast they can move."""

from __future__ import annotations

from sensor_msgs.msg import JointState
from std_msgs.msg import String

from infomap_ros.errors import PoseUnavailableError
from infomap_ros.messages import decode_joint_state, decode_text
from infomap_ros.motion.robot.mechanism import JointLimits
from infomap_ros.nodes.common import qos
from infomap_ros.nodes.common.base import MonitoredNode
from infomap_ros.nodes.robot.robot_tracker import RobotTrackerConfig

_NANOSECONDS = 1_000_000_000


class JointListener:
    """Listens to joint_states and robot_description.

    Args:
        node: that listens.

    Attributes:
        positions: newest position of each joint [rad or m].
        velocities: newest velocity [rad/s or m/s], from two positions where none is published.
    """

    def __init__(self, node: MonitoredNode) -> None:
        self._description = node.config(RobotTrackerConfig).robot
        self.positions: dict[str, float] = {}
        self.velocities: dict[str, float] = {}
        self._stamps: dict[str, int] = {}
        self._limits: dict[str, JointLimits] | None = None
        node.listen(JointState, "joint_states", self._on_joints, qos.sensor_data(100))
        node.listen(String, "robot_description", self._on_description, qos.latched())

    @property
    def limits(self) -> dict[str, JointLimits]:
        """Limits of the robot's joints, by name.

        Raises:
            PoseUnavailableError: robot_description or joint_states has not arrived.
        """
        if self._limits is None or not self.positions:
            raise PoseUnavailableError("robot_description or joint_states has not arrived yet")
        return self._limits

    def _on_description(self, message: String) -> None:
        robot = self._description.read(decode_text(message).text)
        self._limits = {joint.name: joint for joint in robot.joints}

    def _on_joints(self, message: JointState) -> None:
        record = decode_joint_state(message)
        for index, name in enumerate(record.names):
            position, before = float(record.positions[index]), self.positions.get(name)
            passed = (record.stamp - self._stamps.get(name, record.stamp)) / _NANOSECONDS
            if record.velocities is not None:
                self.velocities[name] = float(record.velocities[index])
            elif before is not None and passed > 0.0:
                self.velocities[name] = (position - before) / passed
            self.positions[name], self._stamps[name] = position, record.stamp
