"""Moves wheels, then arm, in steps until the camera has arrived (Fig. 9 of the paper)."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from infomap_ros.exploration.mission import Mission
from infomap_ros.exploration.planar import way_length
from infomap_ros.exploration.records.run_log import RunLog
from infomap_ros.exploration.robot import Interrupted, Motion, Planner, Robot
from infomap_ros.exploration.task import TaskConfig
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.motion.route import ArmPath, Route

_MOTIONS = 4  # planned again to one view: arm, and where need be base, arm, and arm once more


class CameraMover:
    """Has the robot carry out routes.

    Args:
        robot: that moves.
        planner: plans the rest of the way from where the base has come to stand.
        task: how near the camera must come to a view.
        mission: whose distance grows.
        log: receives every motion.
        on_motion: called after each motion.

    Attributes:
        miss: why the camera has come only near to the last view, and how near; empty where it has
            arrived.
    """

    miss = ""

    def __init__(
        self,
        robot: Robot,
        planner: Planner,
        task: TaskConfig,
        mission: Mission,
        log: RunLog,
        on_motion: Callable[[], None],
    ) -> None:
        self._robot, self._planner, self.task = robot, planner, task
        self._mission, self._log, self._on_motion = mission, log, on_motion

    def follow(self, route: Route, interrupted: Interrupted) -> str:
        """Move arm, base and arm as planned; returns empty, or why it did not come to the end."""
        problem = self._approach(route, interrupted)
        return problem or self._move_arm(route.arm_after, interrupted)

    def bring_camera(self, route: Route, view: FloatArray, interrupted: Interrupted) -> str:
        """Follow a route until the camera is within the task's tolerances of a view.

        The base may stop beside the end of its path: the rest of the way is planned, and checked
        for collisions, from where it really stands. Where the camera cannot be brought within the
        tolerances, `miss` and the log say why and how far off it is, and it stays as near as it
        came.

        Args:
            route: that was planned to the view.
            view: ``T_map_camera``, shape (4, 4).
            interrupted: whether to break off.

        Returns:
            Empty, or why a motion did not come to its end.
        """
        self.miss, is_unfolded = "", not route.moves_base
        problem = self._carry_out(route, interrupted)
        if not route.arm_after.moves:  # of a partial route: the arm stays folded
            return problem
        reason = f"after {_MOTIONS} motions"
        for _ in range(_MOTIONS):
            if problem or interrupted():
                return problem
            if is_unfolded and self._has_arrived(view):
                return ""
            plan = self._planner.plan_arm(self._robot.state(), view)
            reason = plan.reason or reason
            if plan.route is not None:
                problem = self._carry_out(plan.route, interrupted)
                is_unfolded = not plan.route.moves_base
            if plan.reason:
                break
        if not problem and not self._has_arrived(view):
            self._note_miss(view, reason)
        return problem

    def _carry_out(self, route: Route, interrupted: Interrupted) -> str:
        """Drive, or move the arm alone: after a drive its motion is planned again."""
        problem = self._approach(route, interrupted)
        if problem or route.moves_base:
            return problem
        return self._move_arm(route.arm_after, interrupted)

    def _approach(self, route: Route, interrupted: Interrupted) -> str:
        """Fold the arm and drive; returns empty, or why that did not come to its end."""
        problem = self._move_arm(route.arm_before, interrupted)
        if problem or not route.moves_base:
            return problem
        motion = self._robot.drive(route.base_path, interrupted)
        self._mission.distance += way_length(motion.path)
        return self._note("drive", motion)

    def _move_arm(self, path: ArmPath, interrupted: Interrupted) -> str:
        return self._note("arm", self._robot.move_arm(path, interrupted)) if path.moves else ""

    def _note(self, action: str, motion: Motion) -> str:
        self._log.write("motion", action=action, outcome=motion.outcome, path=motion.path)
        self._on_motion()
        return f"{action}: {motion.outcome}" if motion.outcome else ""

    def _has_arrived(self, view: FloatArray) -> bool:
        away, turned = camera_error(self._robot.state().T_map_camera, view)
        task = self.task
        return away <= task.view_position_tolerance and turned <= task.view_angle_tolerance

    def _note_miss(self, view: FloatArray, reason: str) -> None:
        away, turned = camera_error(self._robot.state().T_map_camera, view)
        self.miss = f"the camera is {away:.3f} m and {turned:.3f} rad off the view: {reason}"
        self._log.write("message", text=self.miss, level="info")


def camera_error(T_map_camera: FloatArray, view: FloatArray) -> tuple[float, float]:
    """How far a camera is from a view, and the angle between their optical axes.

    Args:
        T_map_camera: pose of the optical frame, shape (4, 4).
        view: likewise.

    Returns:
        Distance [m] and angle [rad]; the roll about the optical axis does not count.
    """
    away = float(np.linalg.norm(T_map_camera[:3, 3] - view[:3, 3]))
    across = float(np.linalg.norm(np.cross(T_map_camera[:3, 2], view[:3, 2])))
    return away, math.atan2(across, float(T_map_camera[:3, 2] @ view[:3, 2]))
