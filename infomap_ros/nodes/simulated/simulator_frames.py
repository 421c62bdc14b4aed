"""tf of the simulated robot, as its odometry and a robot_state_publisher would send it."""

from __future__ import annotations

from dataclasses import replace

from infomap_ros.geometry import OdometryRecord, TransformRecord, invert_transform
from infomap_ros.messages import TF, encode_transforms
from infomap_ros.nodes.common import qos
from infomap_ros.nodes.common.base import MonitoredNode
from infomap_ros.nodes.common.message_types import RclpyMessageTypes, message_class
from infomap_ros.simulation.body.robot import fixed_frames, moving_frames
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
