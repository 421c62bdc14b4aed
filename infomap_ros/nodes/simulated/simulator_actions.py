"""The simulated robot's controllers: FollowJointTrajectory and FollowPath.

Commands to the simulated robot: cmd_vel, base_path, arm_trajectory.
"""

from __future__ import annotations

import queue
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

from geometry_msgs.msg import PoseWithCovarianceStamped, Twist
from nav_msgs.msg import Path
from rclpy.action import ActionServer, CancelResponse, GoalResponse
from rclpy.action.server import ServerGoalHandle
from rclpy.node import Node
from trajectory_msgs.msg import JointTrajectory

from infomap_ros.errors import InfomapError
from infomap_ros.geometry.config import check_config, parameter
from infomap_ros.messages import decode_pose_with_covariance
from infomap_ros.messages.commands import (
    decode_arm_trajectory,
    decode_base_path,
    decode_velocity,
)
from infomap_ros.nodes.common import qos
from infomap_ros.nodes.common.base import MonitoredNode
from infomap_ros.nodes.driving.motion_result import (
    FOLLOW_JOINT_TRAJECTORY,
    FOLLOW_PATH,
    action_class,
)
from infomap_ros.nodes.simulated.simulator_outputs import SimulatorOutputsConfig
from infomap_ros.simulation.body.arm_motion import why_refused
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

    def report_problem(self) -> None:
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


class GoalServer:
    """The server; its owner moves, and says with `end` how that ended.

    Args:
        node: that offers the action.
        action: class of the action.
        name: of the action.
        refuse: why a goal is refused, empty where it is accepted.
        begin: called with a goal that has been accepted.
        replaced: result of a goal whose place a new one takes.
    """

    def __init__(
        self,
        node: Node,
        action: Any,
        name: str,
        refuse: Callable[[Any], str],
        begin: Callable[[Any], None],
        replaced: Any,
    ) -> None:
        self._node, self._refuse, self._begin = node, refuse, begin
        self._replaced, self._name = replaced, name
        self._current: ServerGoalHandle | None = None
        self._ends: dict[bytes, tuple[str, Any]] = {}
        self._server = ActionServer(
            node,
            action,
            name,
            self._finish,
            goal_callback=self._on_goal,
            handle_accepted_callback=self._on_accepted,
            cancel_callback=lambda _: CancelResponse.ACCEPT,
        )

    @property
    def is_active(self) -> bool:
        """Whether a goal is being carried out."""
        return self._current is not None

    @property
    def is_cancel_wanted(self) -> bool:
        """Whether the goal that is being carried out is to be canceled."""
        return self._current is not None and bool(self._current.is_cancel_requested)

    def end(self, state: str, result: Any) -> None:
        """End the goal that is being carried out; from any thread.

        Args:
            state: succeeded, aborted or canceled.
            result: the message.
        """
        current, self._current = self._current, None  # executed now: some executors poll what waits
        if current is not None:
            self._ends[bytes(current.goal_id.uuid)] = state, result
            current.execute()

    def destroy(self) -> None:
        """Offer the action no longer."""
        self._server.destroy()

    def _on_goal(self, goal: Any) -> GoalResponse:
        refused = self._refuse(goal)
        if refused:
            self._node.get_logger().error(f"{self._name} refuses a goal: {refused}")
        return GoalResponse.REJECT if refused else GoalResponse.ACCEPT

    def _on_accepted(self, handle: ServerGoalHandle) -> None:
        self.end("aborted", self._replaced)
        self._current = handle
        self._begin(handle.request)

    def _finish(self, handle: ServerGoalHandle) -> Any:
        state, result = self._ends.pop(bytes(handle.goal_id.uuid))
        finish = {
            "succeeded": handle.succeed,
            "aborted": handle.abort,
            "canceled": handle.canceled if handle.is_cancel_requested else handle.abort,
        }
        finish[state]()
        return result


ARM_CONTROLLER = "arm_controller"


class SimulatorActions:
    """Offers the actions in place of base_path and arm_trajectory.

    Callbacks queue; the thread that simulates carries out and ends goals.

    Args:
        node: that offers them.
        simulator: whose robot moves.
        inputs: carries the commands out.

    Raises:
        ResourceError: control_msgs or nav2_msgs is not installed.
    """

    def __init__(self, node: MonitoredNode, simulator: Simulator, inputs: SimulatorInputs) -> None:
        self._simulator, self._inputs = simulator, inputs
        self._trajectory = action_class(FOLLOW_JOINT_TRAJECTORY).Result
        self._path = action_class(FOLLOW_PATH).Result
        self._begun = {"arm": False, "base": False}
        replaced = self._trajectory(
            error_code=self._trajectory.INVALID_GOAL, error_string="a new goal has come"
        )
        self._arm = GoalServer(
            node,
            action_class(FOLLOW_JOINT_TRAJECTORY),
            f"{ARM_CONTROLLER}/follow_joint_trajectory",
            self._refuse_trajectory,
            self._begin_trajectory,
            replaced,
        )
        self._base = GoalServer(
            node,
            action_class(FOLLOW_PATH),
            "follow_path",
            lambda _: "",
            self._begin_path,
            self._path(),
        )

    def update(self) -> None:
        """End goals that are reached, given up or canceled; called by the thread that simulates."""
        simulator = self._simulator
        if self._arm.is_active and self._begun["arm"]:
            if self._arm.is_cancel_wanted:
                simulator.stop_arm()
                self._arm.end("canceled", self._trajectory())
            elif not simulator.arm_motion[0]:
                self._end_trajectory(self._trajectory.GOAL_TOLERANCE_VIOLATED)
        if self._base.is_active and self._begun["base"]:
            if self._base.is_cancel_wanted:
                simulator.stop_base()
                self._base.end("canceled", self._path())
            elif not simulator.base_motion[0]:
                self._end_path(self._path.FAILED_TO_MAKE_PROGRESS)

    def _refuse_trajectory(self, goal: Any) -> str:
        try:
            command = decode_arm_trajectory(goal.trajectory)
        except InfomapError as error:
            return str(error)
        joints = self._simulator.config.robot.arm_joints  # hands and heads have their own
        return why_refused(command, joints, self._simulator.stamp)

    def _begin_trajectory(self, goal: Any) -> None:
        command = decode_arm_trajectory(goal.trajectory)
        self._submit(
            "arm", lambda: self._inputs.robot.follow_arm_trajectory(command), self._fail_trajectory
        )

    def _begin_path(self, goal: Any) -> None:
        def follow() -> None:
            self._inputs.robot.follow_base_path(decode_base_path(goal.path))

        self._submit("base", follow, self._fail_path)

    def _submit(self, limb: str, command: Callable[[], None], fail: Callable[[str], None]) -> None:
        self._begun[limb] = False

        def carry_out() -> None:
            self._begun[limb] = True
            try:
                command()
            except InfomapError as error:
                fail(str(error))
                raise

        self._inputs.submit(limb, carry_out)

    def _fail_trajectory(self, words: str) -> None:
        code = self._trajectory.INVALID_GOAL
        self._arm.end("aborted", self._trajectory(error_code=code, error_string=words))

    def _fail_path(self, words: str) -> None:
        self._base.end("aborted", self._path(error_code=self._path.INVALID_PATH, error_msg=words))

    def _end_trajectory(self, code: int) -> None:
        problem = self._simulator.arm_motion[1]
        if problem:
            self._arm.end("aborted", self._trajectory(error_code=code, error_string=problem))
        else:
            self._arm.end("succeeded", self._trajectory())

    def _end_path(self, code: int) -> None:
        problem = self._simulator.base_motion[1]
        if problem:
            self._base.end("aborted", self._path(error_code=code, error_msg=problem))
        else:
            self._base.end("succeeded", self._path())
