"""Commands to the simulated robot: cmd_vel, base_path, arm_trajectory."""

from __future__ import annotations

import queue
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

from geometry_msgs.msg import PoseWithCovarianceStamped, Twist
from nav_msgs.msg import Path
from trajectory_msgs.msg import JointTrajectory

from infomap_ros.errors import FrameError, InvalidInputError, PoseUnavailableError
from infomap_ros.geometry import PoseRecord, invert_transform
from infomap_ros.geometry.config import check_config, parameter
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.messages import decode_pose_with_covariance
from infomap_ros.messages.commands import (
    ArmTrajectoryCommand,
    BasePathCommand,
    decode_arm_trajectory,
    decode_base_path,
    decode_velocity,
)
from infomap_ros.nodes.common import qos
from infomap_ros.nodes.common.base import MonitoredNode
from infomap_ros.nodes.simulated.simulator_outputs import SimulatorOutputsConfig
from infomap_ros.simulation.body.controller_rules import why_refused
from infomap_ros.simulation.simulator import Simulator

_KEPT = 400  # places of the camera in odom, by stamp


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
    """

    def __init__(self, node: MonitoredNode, simulator: Simulator) -> None:
        self._node, self._simulator = node, simulator
        self._map_frame = node.config(SimulatorOutputsConfig).map_frame
        self._commands: queue.SimpleQueue[tuple[str, Callable[[], None]]] = queue.SimpleQueue()
        self._T_odom_map: FloatArray | None = None
        self._places: dict[int, FloatArray] = {}
        self._problem = ""
        self._in_map = False
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
        stamp = self._simulator.stamp
        if stamp not in self._places:
            self._places[stamp] = self._simulator.odometry_camera_pose()
        while len(self._places) > _KEPT:
            del self._places[next(iter(self._places))]
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
        self.submit("base_path", partial(self.follow, decode_base_path(message)))

    def _on_trajectory(self, message: object) -> None:
        command = decode_arm_trajectory(message)
        self.submit("arm_trajectory", partial(self.move_arm, command))

    def _on_pose(self, message: object) -> None:
        pose = decode_pose_with_covariance(message)
        self.submit("camera_pose", partial(self._localise, pose))

    def move_arm(self, command: ArmTrajectoryCommand) -> None:
        """Move the arm along a trajectory that a controller would accept.

        Raises:
            InvalidInputError: a controller would refuse it.
            RobotModelError: a joint is unknown.
        """
        joints = self._simulator.arm_joints
        refused = why_refused(command, joints, self._simulator.stamp, allow_partial=True)
        if refused:
            raise InvalidInputError("arm trajectory", refused)
        self._simulator.follow_arm_trajectory(command.names, command.positions, command.times)

    def follow(self, command: BasePathCommand) -> None:
        """Follow a path in odom or in the map.

        Raises:
            FrameError: it is in another frame.
            PoseUnavailableError: it is in the map, and no camera_pose has come.
        """
        if not len(command.poses):
            self._simulator.stop_base()
            return
        if command.frame_id == "odom":
            self._in_map = False
            self._simulator.follow_base_path(command.poses)
            return
        if command.frame_id != self._map_frame:
            raise FrameError(
                f"base_path in frame '{command.frame_id}', expected '{self._map_frame}' or 'odom'"
            )
        if self._T_odom_map is None:
            raise PoseUnavailableError("no camera_pose has come: the map is not known in odom")
        self._simulator.follow_base_path(command.poses, self._T_odom_map)
        self._in_map = True

    def _localise(self, pose: PoseRecord) -> None:
        """Learn from camera_pose where the map is in odom, and correct the path by it."""
        place = self._places.get(pose.stamp)
        if place is None or pose.frame_id != self._map_frame:
            return
        self._T_odom_map = place @ invert_transform(pose.transform)
        if self._in_map:
            self._simulator.correct_path(self._T_odom_map)
