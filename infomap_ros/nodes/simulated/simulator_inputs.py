"""Commands to the simulated robot: cmd_vel, base_path, arm_trajectory."""

from __future__ import annotations

import queue
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

from geometry_msgs.msg import PoseWithCovarianceStamped, Twist
from nav_msgs.msg import Path
from trajectory_msgs.msg import JointTrajectory

from infomap_ros.geometry.config import check_config, parameter
from infomap_ros.messages import decode_pose_with_covariance
from infomap_ros.messages.commands import (
    decode_arm_trajectory,
    decode_base_path,
    decode_velocity,
)
from infomap_ros.nodes.common import qos
from infomap_ros.nodes.common.base import MonitoredNode
from infomap_ros.nodes.simulated.simulator_outputs import SimulatorOutputsConfig
from infomap_ros.simulation.robot_commands import RobotCommands
from infomap_ros.simulation.simulator import Simulator


@dataclass(frozen=True)
class SimulatorInputsConfig:
    """What the simulated robot listens to besides cmd_vel.

    Raises:
        ConfigError: a value is out of its range.
    """

    commands: str = parameter(
        "topics",
        "topics: base_path and arm_trajectory; actions: follow_path, and follow_joint_trajectory "
        "of arm_controller, for robot_driver.",
        choices=("topics", "actions"),
    )

    def __post_init__(self) -> None:
        check_config(self)


class SimulatorInputs:
    """Listens to commands, and to camera_pose for paths that are given in the map.

    Callbacks queue; the thread that simulates carries out, between two steps.

    Args:
        node: that listens.
        simulator: whose robot is commanded.

    Attributes:
        robot: carries the commands out.
    """

    def __init__(self, node: MonitoredNode, simulator: Simulator) -> None:
        self._node, self._simulator = node, simulator
        self.robot = RobotCommands(simulator, node.config(SimulatorOutputsConfig).map_frame)
        self._commands: queue.SimpleQueue[tuple[str, Callable[[], None]]] = queue.SimpleQueue()
        self._problem = ""
        commands: list[tuple[type, str, Callable[[object], None]]] = [
            (Twist, "cmd_vel", self._on_velocity)
        ]
        if node.config(SimulatorInputsConfig).commands == "topics":
            commands.append((Path, "base_path", self._on_path))
            commands.append((JointTrajectory, "arm_trajectory", self._on_trajectory))
        for kind, topic, handle in commands:
            node.listen(kind, topic, handle, qos.stream(), required=False)
        node.listen(
            PoseWithCovarianceStamped,
            "camera_pose",
            self._on_pose,
            qos.sensor_data(50),
            required=False,
        )

    def submit(self, topic: str, command: Callable[[], None]) -> None:
        """Have the thread that simulates carry out a command."""
        self._commands.put((topic, command))

    def carry_out(self) -> None:
        """Give the robot the commands that have come; note where the camera is in odom."""
        self.robot.note_place()
        while not self._commands.empty():
            topic, command = self._commands.get()
            self._node.guard(topic, command)

    def tell_problem(self) -> None:
        """Say once why a motion ended before its goal."""
        problem = self._simulator.problem
        if problem != self._problem:
            self._problem = problem
            self._node.health.note("motion problem", problem or "none")
            if problem:
                self._node.get_logger().warning(problem)

    def _on_velocity(self, message: object) -> None:
        speed, rate = decode_velocity(message)
        self.submit("cmd_vel", partial(self._simulator.command_velocity, speed, rate))

    def _on_path(self, message: object) -> None:
        command = decode_base_path(message)
        self.submit("base_path", partial(self.robot.follow_base_path, command))

    def _on_trajectory(self, message: object) -> None:
        command = decode_arm_trajectory(message)
        self.submit("arm_trajectory", partial(self.robot.follow_arm_trajectory, command))

    def _on_pose(self, message: object) -> None:
        pose = decode_pose_with_covariance(message)
        self.submit("camera_pose", partial(self.robot.locate, pose))
