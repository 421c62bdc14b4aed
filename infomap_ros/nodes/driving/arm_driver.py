"""Carries out arm_trajectory on the controllers of the arm."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace

from rclpy.action import ActionClient
from sensor_msgs.msg import JointState
from std_msgs.msg import String
from trajectory_msgs.msg import JointTrajectory

from infomap_ros.errors import InfomapError, PoseUnavailableError
from infomap_ros.messages import decode_joint_state, decode_text
from infomap_ros.messages.commands import decode_arm_trajectory
from infomap_ros.messages.motions import encode_arm_stop, encode_arm_trajectory, encode_duration
from infomap_ros.motion.arm.controller_trajectories import (
    ControllerTrajectory,
    read_controllers,
    split_trajectory,
)
from infomap_ros.motion.robot.mechanism import JointLimits
from infomap_ros.motion.route import ArmPath
from infomap_ros.nodes.common import qos
from infomap_ros.nodes.common.base import MonitoredNode
from infomap_ros.nodes.common.message_types import RclpyMessageTypes
from infomap_ros.nodes.driving.action_motion import REPLACED, ActionMotions, GoalRequest
from infomap_ros.nodes.driving.driver_config import RobotDriverConfig
from infomap_ros.nodes.driving.motion_result import (
    ARM,
    FOLLOW_JOINT_TRAJECTORY,
    MotionResult,
    Order,
    Outcome,
    action_class,
    explain_trajectory,
)
from infomap_ros.nodes.robot.robot_tracker import RobotTrackerConfig

_SLACK = 5.0  # [s] that a controller's result may come after its goal_time_tolerance
_ARRIVED = 0.03  # [rad or m] that a joint without a result may be off its goal
_MOVES = 0.01  # [rad/s or m/s] above which a joint moves
# The arm has failed when it has not arrived so long after the end of its trajectory [s].
_GOAL_TIME = 5.0
_PERIOD = 0.1  # [s] between two looks at joints that move without a result
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
        self._description, self._health = node.config(RobotTrackerConfig).robot, node.health
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
        self._health.note_joints(record.names)
        for index, name in enumerate(record.names):
            position, before = float(record.positions[index]), self.positions.get(name)
            passed = (record.stamp - self._stamps.get(name, record.stamp)) / _NANOSECONDS
            if record.velocities is not None:
                self.velocities[name] = float(record.velocities[index])
            elif before is not None and passed > 0.0:
                self.velocities[name] = (position - before) / passed
            self.positions[name], self._stamps[name] = position, record.stamp


class ArmDriver:
    """Gives each controller its part of a trajectory and reports what became of it.

    Args:
        node: has the configurations of driver and frames.
        report: takes results.

    Raises:
        ResourceError: control_msgs is not installed.
    """

    def __init__(self, node: MonitoredNode, report: Callable[[MotionResult], None]) -> None:
        self._node, self._report = node, report
        self._config, self._types = node.config(RobotDriverConfig), RclpyMessageTypes()
        self._controllers = read_controllers(self._config.controllers)
        self._joints = JointListener(node)
        if self._config.arm == "follow_joint_trajectory":
            self._carrier: _Actions | _Topics = _Actions(node, self._controllers)
        else:
            self._carrier = _Topics(node, self._controllers, self._joints)
        node.listen(JointTrajectory, ARM, self._on_trajectory, qos.stream(), required=False)

    def stop(self, cause: str) -> None:
        """Stop the arm, and say why."""
        self._carrier.stop(cause)

    def halt(self) -> None:
        """Stop before this node ends."""
        self.stop("robot_driver ends")

    @property
    def is_active(self) -> bool:
        """Whether a motion has not ended."""
        return self._carrier.is_active

    def _on_trajectory(self, message: JointTrajectory) -> None:
        if not message.points:
            self.stop("an empty trajectory was commanded")
            return
        stamp = message.header.stamp.sec * _NANOSECONDS + message.header.stamp.nanosec
        order = Order(ARM, stamp, message.header.frame_id, self._report)
        try:
            command = decode_arm_trajectory(message)
            path = ArmPath(command.names, command.positions, command.times)
            present, limits = self._joints.positions, self._joints.limits
            parts = split_trajectory(path, self._controllers, present, limits)
        except InfomapError as error:
            self.stop("a newer command could not be carried out")
            order.end(Outcome.FAILED, str(error))
            raise
        if self.is_active:
            parts = [self._begun_in_motion(part) for part in parts]
        self._carrier.start(order, parts)

    def _begun_in_motion(self, part: ControllerTrajectory) -> ControllerTrajectory:
        """The part from joints that move: at its first knot they have the velocity of now."""
        velocities = part.velocities.copy()
        velocities[0] = [self._joints.velocities.get(name, 0.0) for name in part.joints]
        return replace(part, velocities=velocities)


def action_of(controller: str) -> str:
    """Name of the action of a controller."""
    return f"{controller}/follow_joint_trajectory"


def topic_of(controller: str) -> str:
    """Name of the topic of a controller."""
    return f"{controller}/joint_trajectory"


class _Actions:
    """The controllers' actions."""

    def __init__(self, node: MonitoredNode, controllers: Iterable[str]) -> None:
        self._types = RclpyMessageTypes()
        self._action = action_class(FOLLOW_JOINT_TRAJECTORY)
        self._clients = {
            name: ActionClient(node, self._action, action_of(name)) for name in controllers
        }
        self._motions = ActionMotions(node, [action_of(name) for name in self._clients])

    @property
    def is_active(self) -> bool:
        return self._motions.is_active

    def start(self, order: Order, parts: Sequence[ControllerTrajectory]) -> None:
        self._motions.start(order, [[self._request(part) for part in parts]])

    def stop(self, cause: str) -> None:
        self._motions.stop(cause)

    def _request(self, part: ControllerTrajectory) -> GoalRequest:
        goal = self._action.Goal(
            trajectory=_message(self._types, part),
            goal_time_tolerance=encode_duration(self._types, _GOAL_TIME),
        )
        limit = float(part.times[-1]) + _GOAL_TIME + _SLACK
        return GoalRequest(
            part.controller, self._clients[part.controller], goal, explain_trajectory, limit
        )


class _Topics:
    """The controllers' topics, which give no result: the joints tell."""

    def __init__(
        self, node: MonitoredNode, controllers: Mapping[str, Sequence[str]], joints: JointListener
    ) -> None:
        self._types = RclpyMessageTypes()
        self._clock, self._joints = node.motion_clock, joints
        self._controllers = controllers
        self._publishers = {
            name: node.advertise(JointTrajectory, topic_of(name), qos.stream())
            for name in controllers
        }
        self._order: Order | None = None
        self._parts: Sequence[ControllerTrajectory] = ()
        self._end = 0
        node.create_timer(_PERIOD, self._look, clock=self._clock)

    @property
    def is_active(self) -> bool:
        return self._order is not None

    def start(self, order: Order, parts: Sequence[ControllerTrajectory]) -> None:
        touched = {part.controller for part in parts}
        left = {p.controller: p.joints for p in self._parts if p.controller not in touched}
        self._halt(left)
        if self._order is not None:
            self._order.end(Outcome.CANCELED, REPLACED)
        for part in parts:
            self._publishers[part.controller].publish(_message(self._types, part))
        self._order, self._parts = order, parts
        duration = round(float(parts[0].times[-1]) * _NANOSECONDS)
        self._end = self._clock.now().nanoseconds + duration

    def stop(self, cause: str) -> None:
        if self._order is not None:
            self._halt({part.controller: part.joints for part in self._parts})
            self._finish(Outcome.CANCELED, cause)
            return
        known, velocities = self._joints.positions, self._joints.velocities
        self._halt(  # what another has begun, such as this node before it was killed
            {
                name: joints
                for name, joints in self._controllers.items()
                if known.keys() >= set(joints)
                and any(abs(velocities.get(joint, 0.0)) > _MOVES for joint in joints)
            }
        )

    def _halt(self, controllers: Mapping[str, Sequence[str]]) -> None:
        """Let controllers, by name, slow down their joints and stand."""
        joints = self._joints
        for controller, names in controllers.items():
            stop = encode_arm_stop(self._types, names, joints.positions, joints.velocities)
            self._publishers[controller].publish(stop)

    def _look(self) -> None:
        """See whether the joints have arrived."""
        late = (self._clock.now().nanoseconds - self._end) / _NANOSECONDS
        if self._order is None or late < 0.0:
            return
        errors = {
            name: abs(self._joints.positions[name] - goal)
            for part in self._parts
            for name, goal in zip(part.joints, part.positions[-1], strict=True)
        }
        worst = max(errors, key=errors.__getitem__)
        if errors[worst] <= _ARRIVED:
            self._finish(Outcome.SUCCEEDED, "")
        elif late > _GOAL_TIME:
            self._halt({part.controller: part.joints for part in self._parts})
            reason = f"'{worst}' is {errors[worst]:.3f} off its goal {late:.1f} s after the end"
            self._finish(Outcome.FAILED, reason)

    def _finish(self, outcome: Outcome, reason: str) -> None:
        order, self._order, self._parts = self._order, None, ()
        if order is not None:
            order.end(outcome, reason)


def _message(types: RclpyMessageTypes, part: ControllerTrajectory) -> JointTrajectory:
    path = ArmPath(part.joints, part.positions, part.times)
    message: JointTrajectory = encode_arm_trajectory(types, 0, path, part.velocities)
    return message
