"""Carries out base_path: by Nav2, or by this node on cmd_vel."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from nav_msgs.msg import Path
from rclpy.action import ActionClient

from infomap_ros.errors import InfomapError
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.messages.commands import BasePathCommand, decode_base_path
from infomap_ros.messages.motions import encode_base_path
from infomap_ros.motion.base.path_following import split_path
from infomap_ros.nodes.common import qos
from infomap_ros.nodes.common.base import MonitoredNode
from infomap_ros.nodes.common.message_types import RclpyMessageTypes
from infomap_ros.nodes.driving.action_goal import GoalRequest
from infomap_ros.nodes.driving.action_motion import ActionMotions
from infomap_ros.nodes.driving.action_types import (
    FOLLOW_PATH,
    NAVIGATE_THROUGH_POSES,
    action_class,
    explain_navigation,
)
from infomap_ros.nodes.driving.driver_config import RobotDriverConfig
from infomap_ros.nodes.driving.motion_result import BASE, MotionResult, Order, Outcome
from infomap_ros.nodes.driving.velocity_base import VelocityBase

_SPACING = 0.5  # [m] of the poses that a navigator is sent through: it plans between them
_NANOSECONDS = 1_000_000_000


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
        goal = self._action.Goal(behavior_tree=self._config.behavior_tree)
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
