"""The simulated robot's controllers: FollowJointTrajectory and FollowPath."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from rclpy.action import ActionServer, CancelResponse, GoalResponse
from rclpy.action.server import ServerGoalHandle
from rclpy.node import Node

from infomap_ros.errors import InfomapError
from infomap_ros.messages.commands import decode_arm_trajectory, decode_base_path
from infomap_ros.nodes.common.base import MonitoredNode
from infomap_ros.nodes.driving.action_types import (
    FOLLOW_JOINT_TRAJECTORY,
    FOLLOW_PATH,
    action_class,
)
from infomap_ros.nodes.simulated.simulator_inputs import SimulatorInputs
from infomap_ros.simulation.body.controller_rules import why_refused
from infomap_ros.simulation.simulator import Simulator


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
