"""Controllers on paper that keep the rules of joint_trajectory_controller and of Nav2 (Jazzy)."""

from __future__ import annotations

from typing import Any

import numpy as np
from geometry_msgs.msg import Twist
from scipy.interpolate import CubicHermiteSpline
from sensor_msgs.msg import JointState
from trajectory_msgs.msg import JointTrajectory

from infomap_ros.errors import MalformedMessageError
from infomap_ros.geometry import make_transform
from infomap_ros.messages.commands import (
    ArmTrajectoryCommand,
    decode_arm_trajectory,
    decode_base_path,
)
from infomap_ros.nodes.driving.motion_result import (
    FOLLOW_JOINT_TRAJECTORY,
    FOLLOW_PATH,
    NAVIGATE_THROUGH_POSES,
    action_class,
)
from infomap_ros.nodes.simulated.simulator_actions import GoalServer
from infomap_ros.simulation.body.arm_motion import why_refused

PERIOD = 0.02  # [s]


class TrajectoryController:
    """One joint_trajectory_controller: its action and its topic, and the joints that it moves.

    It accepts by the rules of the real one, goes along the cubic through positions and velocities,
    succeeds when all joints are at the end, and aborts when they are not `goal_time_tolerance`
    later. A new goal aborts the one before; a canceled one leaves the joints where they are.

    Args:
        graph: in which it is.
        name: of the controller.
        joints: where its joints are [rad or m].
        publishes: its joints on joint_states.

    Attributes:
        stuck: joints that do not move.
        slower: factor by which trajectories that come take longer than they say.
        inactive: refuse all, as a controller that is not running.
        goals: trajectories that were accepted.
        refused: why others were not.
        canceled: number of goals that were canceled.
    """

    def __init__(
        self, graph: Any, name: str, joints: dict[str, float], publishes: bool = True
    ) -> None:
        self.joints, self.stuck, self.inactive = joints, set[str](), False
        self.goals: list[ArmTrajectoryCommand] = []
        self.refused: list[str] = []
        self.canceled, self.slower = 0, 1.0
        self._node, self._motion, self._tolerance = graph.tester, None, 0.0
        self._command: ArmTrajectoryCommand | None = None
        self._begun = 0.0
        action = action_class(FOLLOW_JOINT_TRAJECTORY)
        self.result = action.Result
        replaced = self.result(error_code=self.result.INVALID_GOAL, error_string="replaced")
        self.server = GoalServer(
            self._node, action, f"{name}/follow_joint_trajectory",
            lambda goal: self._refusal(goal.trajectory), self._on_goal, replaced,
        )  # fmt: skip
        self._node.create_subscription(
            JointTrajectory, f"{name}/joint_trajectory", self._on_topic, 10
        )
        self._states = graph.publisher(JointState, "joint_states") if publishes else None
        self._node.create_timer(PERIOD, self._move)

    @property
    def moves(self) -> bool:
        return self._command is not None

    def _now(self) -> float:
        return float(self._node.get_clock().now().nanoseconds) * 1e-9

    def _refusal(self, trajectory: Any) -> str:
        if self.inactive:
            return "not running"
        try:
            command = decode_arm_trajectory(trajectory)
        except MalformedMessageError as error:
            refused = str(error)
        else:
            refused = why_refused(command, tuple(self.joints), round(self._now() * 1e9))
        if refused:
            self.refused.append(refused)
        return refused

    def _on_topic(self, message: JointTrajectory) -> None:
        if not self._refusal(message):
            self._begin(decode_arm_trajectory(message))

    def _on_goal(self, goal: Any) -> None:
        duration = goal.goal_time_tolerance
        self._tolerance = duration.sec + 1e-9 * duration.nanosec
        self._begin(decode_arm_trajectory(goal.trajectory))

    def _begin(self, command: ArmTrajectoryCommand) -> None:
        self.goals.append(command)
        self._command, self._begun, self._slower = command, self._now(), self.slower
        here = np.array([[self.joints[name] for name in command.names]])
        speeds = command.velocities
        if speeds is None:
            speeds = np.zeros_like(command.positions)
        skip = int(command.times[0] == 0.0)  # it begins where the joints are
        self._spline = CubicHermiteSpline(
            np.append(0.0, command.times[skip:]),
            np.vstack([here, command.positions[skip:]]),
            np.vstack([speeds[:skip] if skip else np.zeros_like(here), speeds[skip:]]),
        )

    def _move(self) -> None:
        if self.server.is_cancel_wanted:
            self.canceled += 1
            self._command = None
            self.server.end("canceled", self.result())
        if self._command is not None:
            self._advance(self._command)
        if self._states is None:
            return
        state = JointState(name=list(self.joints), position=list(self.joints.values()))
        state.header.stamp = self._node.get_clock().now().to_msg()
        self._states.publish(state)

    def _advance(self, command: ArmTrajectoryCommand) -> None:
        passed = (self._now() - self._begun) / self._slower
        end = float(command.times[-1])
        places = self._spline(min(passed, end))
        for name, place in zip(command.names, places, strict=True):
            if name not in self.stuck:
                self.joints[name] = float(place)
        if passed < end:
            return
        errors = {n: abs(self.joints[n] - q) for n, q in zip(command.names, command.positions[-1],
                                                             strict=True)}  # fmt: skip
        worst = max(errors, key=errors.__getitem__)
        if errors[worst] < 0.01:
            self._command = None
            self.server.end("succeeded", self.result())
        elif passed > end + self._tolerance:
            self._command = None
            words = f"joint {worst} is {errors[worst]:.2f} off"
            code = self.result.GOAL_TOLERANCE_VIOLATED
            self.server.end("aborted", self.result(error_code=code, error_string=words))


class PathController:
    """Nav2's FollowPath or NavigateThroughPoses: moves a base on paper at 2 m/s.

    It accepts any goal, fails on an empty path and on plugins that it does not have, succeeds when
    its goal checker (0.25 m, 0.25 rad) does, and drops a goal for a new one. It turns at the end of
    a path alone. A name that is left empty is that of its only plugin.

    Args:
        graph: in which it is.
        follows: whether it is FollowPath.
        controllers: its plugins.
        checkers: its goal checkers.

    Attributes:
        base: x, y [m], yaw [rad].
        blocked: fail with FAILED_TO_MAKE_PROGRESS.
        goals: poses of the goals that were begun.
        canceled: number of goals that were canceled.
    """

    SPEED = 2.0  # [m/s]

    def __init__(
        self,
        graph: Any,
        follows: bool = True,
        controllers: tuple[str, ...] = ("FollowPath",),
        checkers: tuple[str, ...] = ("general_goal_checker",),
    ) -> None:
        self.controllers, self.checkers = controllers, checkers
        self._unknown: tuple[int, str] | None = None
        self.base, self.blocked = np.zeros(3), False
        self.goals: list[np.ndarray] = []
        self.requests: list[Any] = []
        self.canceled, self._left = 0, np.zeros((0, 3))
        action = action_class(FOLLOW_PATH if follows else NAVIGATE_THROUGH_POSES)
        self.result, self._follows = action.Result, follows
        name = "follow_path" if follows else "navigate_through_poses"
        self.server = GoalServer(
            graph.tester, action, name, lambda _: "", self._on_goal, action.Result()
        )
        graph.tester.create_timer(PERIOD, self._move)

    def _on_goal(self, goal: Any) -> None:
        self.requests.append(goal)
        self._unknown = self._why_unknown(goal) if self._follows else None
        if self._follows:
            self._left = decode_base_path(goal.path).poses
        else:
            poses = [(p.pose.position.x, p.pose.position.y,
                      2.0 * np.arctan2(p.pose.orientation.z, p.pose.orientation.w))
                     for p in goal.poses]  # fmt: skip
            self._left = np.array(poses).reshape(-1, 3)
        self.goals.append(self._left)

    def _why_unknown(self, goal: Any) -> tuple[int, str] | None:
        """As in `ControllerServer::computeControl` of navigation2."""
        for name, own, code, what in (
            (goal.controller_id, self.controllers, 101, "controller"),
            (goal.goal_checker_id, self.checkers, 100, "goal checker"),
        ):
            if name not in own and (name or len(own) != 1):
                return code, f"Failed to find {what} name: {name}"
        return None

    def _move(self) -> None:
        if not self.server.is_active:
            return
        if self.server.is_cancel_wanted:
            self.canceled += 1
            self.server.end("canceled", self.result())
        elif self._unknown is not None:
            code, words = self._unknown
            self.server.end("aborted", self.result(error_code=code, error_msg=words))
        elif not len(self._left):
            self.server.end("aborted", self.result(error_code=103, error_msg="Path is empty."))
        elif self.blocked:
            self.server.end(
                "aborted", self.result(error_code=105, error_msg="Failed to make progress")
            )
        else:
            self._drive()

    def _drive(self) -> None:
        step = self._left[0, :2] - self.base[:2]
        far = float(np.linalg.norm(step))
        if far > self.SPEED * PERIOD:
            self.base[:2] += step * self.SPEED * PERIOD / far
            return
        self.base[:2] = self._left[0, :2]
        if len(self._left) > 1:
            self._left = self._left[1:]
            return
        self.base[2] = self._left[0, 2]
        self.server.end("succeeded", self.result())


class VelocityController:
    """Moves a base on paper by cmd_vel, which it forgets after `patience` seconds.

    Args:
        rover: whose base it moves.
        kind: of the message.
        stuck: whether it does not move.
    """

    def __init__(self, rover: Any, kind: Any = Twist) -> None:
        self.rover, self.stuck, self.patience = rover, False, 0.5
        self.pose = np.zeros(3)
        self.commands: list[tuple[float, float]] = []
        self._age = 1.0
        rover.graph.tester.create_subscription(kind, "cmd_vel", self._on_velocity, 10)
        rover.graph.tester.create_timer(PERIOD, self._move)

    def _on_velocity(self, message: Any) -> None:
        twist = getattr(message, "twist", message)
        self.commands.append((twist.linear.x, twist.angular.z))
        self._age = 0.0

    def _move(self) -> None:
        self._age += PERIOD
        if self._age > self.patience or self.stuck or not self.commands:
            return
        speed, rate = self.commands[-1]
        yaw = self.pose[2]
        self.pose += PERIOD * np.array([speed * np.cos(yaw), speed * np.sin(yaw), rate])
        c, s = np.cos(self.pose[2]), np.sin(self.pose[2])
        turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
        self.rover.base = make_transform(turn, (*self.pose[:2], 0.0))
