"""What breaks the motion to a view off, besides the user."""

from __future__ import annotations

from collections.abc import Sequence

from infomap_ros.exploration.robot import Interrupted, Planner, Robot
from infomap_ros.exploration.rules import MotionMonitor
from infomap_ros.motion.base.pose_margin import base_sigma


class MotionWatch:
    """All monitors of one motion: called as one asks whether the motion is interrupted.

    Args:
        monitors: asked one after the other.
        interrupted: by the user.

    Attributes:
        reason: of the monitor that has broken the motion off; empty where none has.
        rejects_view: whether that monitor rejects the view.
    """

    def __init__(self, monitors: Sequence[MotionMonitor], interrupted: Interrupted) -> None:
        self._monitors, self._interrupted = monitors, interrupted
        self.reason, self.rejects_view = "", False
        for monitor in monitors:
            monitor.begin()

    def __call__(self) -> bool:
        """Whether the motion is to be broken off."""
        for monitor in self._monitors:
            if self.reason:
                break
            self.reason, self.rejects_view = monitor.problem(), monitor.rejects_view
        return bool(self.reason) or self._interrupted()


class DriftMonitor(MotionMonitor):
    """Where the robot is becomes known much less well than when the motion began.

    Args:
        robot: that moves.
        max_drift: that the standard deviation of its position may grow [m].
    """

    rejects_view = False

    def __init__(self, robot: Robot, max_drift: float) -> None:
        self._robot, self.max_drift, self._most = robot, max_drift, 0.0

    def begin(self) -> None:
        """Take how well the robot's place is known now."""
        self._most = self._sigma() + self.max_drift

    def problem(self) -> str:
        """Whether it is known much less well."""
        drifted = self._sigma() > self._most
        return "where the robot is has become too uncertain" if drifted else ""

    def _sigma(self) -> float:
        state = self._robot.state()
        return base_sigma(state.T_map_camera, state.pose_covariance, state.T_map_base, 0.0)


class RouteMonitor(MotionMonitor):
    """What is left of the route is not free any more in the map as it is now.

    Args:
        robot: that moves.
        planner: knows the map, and the route that it planned last.
    """

    rejects_view = True

    def __init__(self, robot: Robot, planner: Planner) -> None:
        self._robot, self._planner = robot, planner

    def begin(self) -> None:
        """The planner has begun with its plan."""

    def problem(self) -> str:
        """Where the route is blocked, and by what."""
        return self._planner.route_problem(self._robot.state())
