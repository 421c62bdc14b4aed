"""Follows paths by publishing velocities on cmd_vel."""

from __future__ import annotations

import numpy as np
from geometry_msgs.msg import Twist, TwistStamped

from infomap_ros.errors import FrameError, PoseUnavailableError
from infomap_ros.exploration.planar import planar_pose
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.messages.commands import BasePathCommand
from infomap_ros.motion.base.path_following import PathDriving
from infomap_ros.nodes.common import qos
from infomap_ros.nodes.common.base import MonitoredNode
from infomap_ros.nodes.driving.action_motion import REPLACED
from infomap_ros.nodes.driving.driver_config import RobotDriverConfig
from infomap_ros.nodes.driving.motion_result import Order, Outcome
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
