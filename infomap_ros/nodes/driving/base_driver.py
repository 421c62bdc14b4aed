"""Carries out base_path: by Nav2, or by this node on cmd_vel.

Follows paths by publishing velocities on cmd_vel.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from geometry_msgs.msg import Twist, TwistStamped
from nav_msgs.msg import Path
from rclpy.action import ActionClient

from infomap_ros.errors import FrameError, InfomapError, PoseUnavailableError
from infomap_ros.exploration.robot import planar_pose
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.messages.commands import BasePathCommand, decode_base_path
from infomap_ros.messages.motions import encode_base_path
from infomap_ros.motion.base.path_following import PathDriving, split_path
from infomap_ros.nodes.common import qos
from infomap_ros.nodes.common.base import MonitoredNode
from infomap_ros.nodes.common.message_types import RclpyMessageTypes
from infomap_ros.nodes.driving.action_motion import REPLACED, ActionMotions, GoalRequest
from infomap_ros.nodes.driving.driver_config import RobotDriverConfig
from infomap_ros.nodes.driving.motion_result import (
    BASE,
    FOLLOW_PATH,
    NAVIGATE_THROUGH_POSES,
    MotionResult,
    Order,
    Outcome,
    action_class,
    explain_navigation,
)
from infomap_ros.nodes.robot.robot_tracker import RobotTracker, RobotTrackerConfig

_PERIOD = 0.05  # [s] between two velocities; twice the rate of common odometry is of no use
_BLIND = 1.0  # [s] without a newer pose after which the base stops
_NANOSECONDS = 1_000_000_000


class VelocityBase:
    """Publishes the velocities that bring the base along a path, and zero at its end.

    Args:
        node: has the configurations of driver and robot tracker.
    """

    def __init__(self, node: MonitoredNode) -> None:
        self._node, config = node, node.config(RobotDriverConfig)
        self._frames = node.config(RobotTrackerConfig)
        self._tracker = RobotTracker(node, infos=("left/camera_info",))
        self._clock, self._stamped = node.get_clock(), config.base == "cmd_vel_stamped"
        self._pace = node.motion_clock
        kind = TwistStamped if self._stamped else Twist
        self._velocities = node.advertise(kind, "cmd_vel", qos.stream(depth=1))
        self._driving = PathDriving(config.following())
        self._order: Order | None = None
        self._cause = ""
        self._in_odometry = False
        self._newest, self._seen, self._last = 0, 0, 0
        node.create_timer(_PERIOD, self._drive, clock=self._pace)

    @property
    def is_active(self) -> bool:
        """Whether a motion has not ended."""
        return self._order is not None

    def follow(self, order: Order, command: BasePathCommand) -> None:
        """Begin a path, in place of the one before.

        Raises:
            FrameError: the path is neither in the map nor in odometry's frame.
            PoseUnavailableError: it is not known where the base is.
            InvalidInputError: the path cannot be followed.
        """
        odom_frame = self._tracker.odom_frame or "odom"
        if command.frame_id not in (self._frames.map_frame, odom_frame):
            expected = f"'{self._frames.map_frame}' or '{odom_frame}'"
            raise FrameError(f"base_path in frame '{command.frame_id}', expected {expected}")
        in_odometry = command.frame_id != self._frames.map_frame
        self._place(in_odometry)
        if self._order is None:  # at rest: with the limits as they are now
            self._driving = PathDriving(self._node.config(RobotDriverConfig).following())
        self._driving.follow(command.poses)
        if self._order is not None:
            self._order.end(Outcome.CANCELED, self._cause or REPLACED)
        self._order, self._cause, self._in_odometry = order, "", in_odometry
        self._newest, self._seen = -1, self._now()
        self._last = self._seen

    def stop(self, cause: str) -> None:
        """Slow down and stand; the order ends then."""
        if self._order is None:
            self.halt()  # of a base that another has set going
        elif not self._cause:
            self._cause = cause
            self._driving.stop()

    def halt(self) -> None:
        """Stand at once."""
        self._publish(0.0, 0.0)

    def _drive(self) -> None:
        """Publish the next velocity."""
        if self._order is None:
            return
        now = self._now()
        period, self._last = max(now - self._last, 0) / _NANOSECONDS, now
        try:
            stamp, place = self._place(self._in_odometry)
        except PoseUnavailableError as error:
            self._finish(Outcome.FAILED, str(error))
            return
        if stamp != self._newest:
            self._newest, self._seen = stamp, now
        elif now - self._seen > _BLIND * _NANOSECONDS:
            self._finish(Outcome.FAILED, f"no pose of the base has come for {_BLIND:g} s")
            return
        self._publish(*self._driving.velocity(place, period))
        if self._driving.problem:
            self._finish(Outcome.FAILED, self._driving.problem)
        elif self._driving.done:
            outcome = Outcome.CANCELED if self._cause else Outcome.SUCCEEDED
            self._finish(outcome, self._cause)

    def _place(self, in_odometry: bool) -> tuple[int, FloatArray]:
        """Stamp of the newest knowledge [ns], and x, y [m], yaw [rad] of the base, shape (3,)."""
        if in_odometry:
            state = self._tracker.state_in_odometry()
            stamp = self._tracker.newest_odometry
        else:
            stamp, state = self._tracker.stamped_state()
        return stamp, np.array(planar_pose(state.T_map_base))

    def _finish(self, outcome: Outcome, reason: str) -> None:
        self.halt()
        self._driving.stand()
        order, self._order, self._cause = self._order, None, ""
        if order is not None:
            order.end(outcome, reason)

    def _publish(self, speed: float, turn_rate: float) -> None:
        twist = Twist()
        twist.linear.x, twist.angular.z = speed, turn_rate
        if not self._stamped:
            self._velocities.publish(twist)
            return
        stamped = TwistStamped(twist=twist)
        stamped.header.stamp = self._clock.now().to_msg()
        stamped.header.frame_id = self._frames.base_frame
        self._velocities.publish(stamped)

    def _now(self) -> int:
        return int(self._pace.now().nanoseconds)


_SPACING = 0.5  # [m] of the poses that a navigator is sent through: it plans between them


class BaseDriver:
    """Has the base follow paths and reports what became of them.

    Args:
        node: has the configurations of driver and robot tracker.
        report: takes results.

    Raises:
        ResourceError: nav2_msgs is not installed.
    """

    def __init__(self, node: MonitoredNode, report: Callable[[MotionResult], None]) -> None:
        self._report = report
        is_nav2 = node.config(RobotDriverConfig).base in ("follow_path", "navigate_through_poses")
        self._carrier: _Nav2 | VelocityBase = _Nav2(node) if is_nav2 else VelocityBase(node)
        node.listen(Path, BASE, self._on_path, qos.stream(), required=False)

    def stop(self, cause: str) -> None:
        """Stop the base, and say why."""
        self._carrier.stop(cause)

    def halt(self) -> None:
        """Stop before this node ends."""
        self._carrier.halt()

    @property
    def is_active(self) -> bool:
        """Whether a motion has not ended."""
        return self._carrier.is_active

    def _on_path(self, message: Path) -> None:
        if len(message.poses) < 2:  # nowhere to go
            self.stop("a path to stay was commanded")
            return
        stamp = message.header.stamp.sec * _NANOSECONDS + message.header.stamp.nanosec
        order = Order(BASE, stamp, message.header.frame_id, self._report)
        try:
            self._carrier.follow(order, decode_base_path(message))
        except InfomapError as error:
            self.stop("a newer command could not be carried out")
            order.end(Outcome.FAILED, str(error))
            raise


class _Nav2:
    """The actions of Nav2: its controller server along the path, or its navigator."""

    def __init__(self, node: MonitoredNode) -> None:
        self._config, self._types = node.config(RobotDriverConfig), RclpyMessageTypes()
        self._follows = self._config.base == "follow_path"
        self._action = action_class(FOLLOW_PATH if self._follows else NAVIGATE_THROUGH_POSES)
        self._client = ActionClient(node, self._action, self._config.base)
        self._motions = ActionMotions(node, [self._config.base])

    @property
    def is_active(self) -> bool:
        return self._motions.is_active

    def follow(self, order: Order, command: BasePathCommand) -> None:
        pieces = split_path(command.poses)
        if self._follows:
            goals = [self._piece(command.frame_id, piece) for piece in pieces]
        else:
            places = np.concatenate([_spaced(piece) for piece in pieces])
            goals = [self._places(command.frame_id, places)]
        self._motions.start(order, [[self._request(goal)] for goal in goals])

    def stop(self, cause: str) -> None:
        self._motions.stop(cause)

    def halt(self) -> None:
        self.stop("robot_driver ends")

    def _request(self, goal: Any) -> GoalRequest:
        return GoalRequest(self._config.base, self._client, goal, explain_navigation)

    def _piece(self, frame_id: str, poses: FloatArray) -> Any:
        """Controllers as Nav2's do not turn on the spot within a path: each piece is a goal."""
        return self._action.Goal(
            path=encode_base_path(self._types, 0, frame_id, poses),  # 0: by the newest tf
            controller_id=self._config.controller_id,
            goal_checker_id=self._config.goal_checker_id,
        )

    def _places(self, frame_id: str, poses: FloatArray) -> Any:
        stamped = encode_base_path(self._types, 0, frame_id, poses).poses
        goal = self._action.Goal()
        if hasattr(goal.poses, "goals"):  # since ROS 2 Kilted
            goal.poses.goals, goal.poses.header.frame_id = stamped, frame_id
        else:
            goal.poses = stamped
        return goal


def _spaced(piece: FloatArray) -> FloatArray:
    """Poses of a piece without its first, and others that are near to the one before."""
    kept, last = [], piece[0]
    for pose in piece[1:-1]:
        if np.hypot(*(pose - last)[:2]) >= _SPACING:
            kept.append(pose)
            last = pose
    return np.array([*kept, piece[-1]])
