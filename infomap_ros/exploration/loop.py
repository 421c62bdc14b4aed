"""The loop of Fig. 3 of Sujan and Dubowsky 2005: look, fuse, rate, choose, move.

What ends the loop and what it does instead of the next view are rules
(`infomap_ros.exploration.rules`), listed in `Exploration.__init__` in the order in which they
count; `MotionWatch` says what breaks a motion off.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import asdict

import numpy as np

from infomap_ros.errors import InfomapError, TeammatesBusyError
from infomap_ros.exploration.mission import Mission
from infomap_ros.exploration.records.run_log import RunLog
from infomap_ros.exploration.robot import (
    Choice,
    FailedView,
    Interrupted,
    KnownPlace,
    MapProgress,
    Motion,
    Planner,
    Robot,
    RobotState,
    path_length,
)
from infomap_ros.exploration.rules import (
    STOPPED,
    BudgetSpent,
    Control,
    Ending,
    EndReason,
    Fallback,
    NoViewLeft,
    PlanOnly,
    Request,
    ReturnToLastView,
    StopRequested,
    StopRule,
    TaskIsMet,
    TooManyFailures,
    UnproductiveViews,
    UserRequests,
    WaitForTeammates,
)
from infomap_ros.exploration.task import TaskConfig
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.motion.route import ArmPath, Route
from infomap_ros.motion.whole_body import base_sigma

__all__ = ["EndReason", "Ending", "Exploration"]


class Exploration:
    """Explores until expanse and resolution suffice, or it is plain that they cannot.

    Args:
        robot: moves and looks.
        planner: chooses the next best view.
        task: what is to be mapped and what it may cost.
        log: receives every step.
        control: requests of the user.
        mission: account of a mission that goes on; a new one where not given.
        plan_only: choose again and again, and move nothing.
        on_step: called after each step, for example to save the mission and report the status.
        clock: seconds of the time in which the robot moves; only differences from the first step on
            count, as a simulator's time may begin late.

    Attributes:
        state: what it is doing, in words.
        last_reason: of the last choice or failure.
        progress: of the map at the last choice; None before.
        mission: the account so far.
    """

    def __init__(
        self,
        robot: Robot,
        planner: Planner,
        task: TaskConfig,
        log: RunLog,
        control: Control | None = None,
        mission: Mission | None = None,
        plan_only: bool = False,
        on_step: Callable[[Exploration], None] = lambda _: None,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self.task, self.mission = task, mission or Mission()
        self.control = control or Control()
        self.state, self.last_reason = "starting", ""
        self.progress: MapProgress | None = None
        self._robot, self._planner, self._log = robot, planner, log
        self._on_step, self._clock = on_step, clock
        self._marked: float | None = None
        self._mover = CameraMover(robot, planner, task, self.mission, log, self._step)
        self._failures, self._teammates = TooManyFailures(task.max_failures), WaitForTeammates()
        self._unproductive, self._return = UnproductiveViews(task), ReturnToLastView(self.mission)
        self._is_met, self._budget = TaskIsMet(task), BudgetSpent(task, self.mission)
        self._rules: list[StopRule | Fallback] = [
            self._failures,
            self._is_met,
            StopRequested(self.control),
            UserRequests(self.control),
            *(() if plan_only else (self._return,)),
            self._teammates,
            NoViewLeft(),
            self._budget,
            PlanOnly() if plan_only else self._unproductive,
        ]

    def change_task(self, task: TaskConfig) -> None:
        """Go on by another task, also from another thread: the next step counts by it."""
        self.task = self._mover.task = task
        self._is_met.task = self._budget.task = self._unproductive.task = task
        self._failures.most = task.max_failures

    def run(self) -> Ending:
        """Explore to the end; says why it ended.

        What goes wrong with the robot or the planner ends in an `Ending` that names it.
        """
        try:
            ending = self._explore()
        except InfomapError as error:
            stopped = self.control.request is Request.STOP  # and what was asked broken off
            ending = STOPPED if stopped else Ending(EndReason.FAILED, str(error))
        return self.end(ending)

    def end(self, ending: Ending) -> Ending:
        """Say that it has ended, and why: `run` does so, and who finds that it cannot begin."""
        self._log.write("end", reason=ending.reason.value, detail=ending.detail)
        self.say(f"ended: {ending.reason.value}", ending.detail)
        return ending

    def say(self, state: str, reason: str | None = None) -> None:
        """State what is done before it begins, and why."""
        self.state = state
        self.last_reason = self.last_reason if reason is None else reason
        self._step()

    def _explore(self) -> Ending:
        """Look and fuse; rate and choose; move; and again, as far as no rule says otherwise."""
        if not self.mission.home.is_known:
            self.mission.note_home(self._robot.state())
        self.look()
        while True:
            choice = None
            rule = self._first_rule(None)
            if rule is None:
                choice = self._choose()
                rule = self._first_rule(choice)
            if isinstance(rule, Ending):
                return rule
            if rule is not None:
                rule.act(self)
            elif choice is not None:
                self._move_and_look(choice)

    def _first_rule(self, choice: Choice | None) -> Ending | Fallback | None:
        """The first rule that applies: the end, or what to do instead of the next step."""
        for rule in self._rules:
            if isinstance(rule, Fallback):
                if rule.applies(choice):
                    return rule
            elif (ending := rule.ending(choice)) is not None:
                return ending
        return None

    def look(self) -> None:
        """Acquire a view and have it fused."""
        self.say("looking")
        problem = self._robot.look(self.control.interrupted)
        self._log.write("motion", action="look", outcome=problem, path=[])
        if self.control.interrupted():
            return
        if problem:
            self._return.failed()
            self._fail(f"look: {problem}")
            return
        self._return.looked(self._robot.state())
        self._failures.reset()
        self.mission.views += 1

    def _choose(self) -> Choice | None:
        """Rate the candidates and choose the next view; None where teammates are at all of them."""
        state = self._robot.state()
        self.mission.note_look(state.T_map_camera)
        self.say("choosing")  # whoever plans learns of the look
        try:
            choice = self._planner.choose(state)
        except TeammatesBusyError as busy:
            self._teammates.reason = str(busy)
            return None
        self.progress, self.last_reason = choice.progress, choice.reason
        self._unproductive.note(self.mission.views, self.mission.seconds, choice.progress)
        account = {"views": self.mission.views, "distance": self.mission.distance}
        self._log.write("progress", **account, **asdict(choice.progress), state=self.state)
        self._log.write("decision", view=self.mission.views, **choice.explanation)
        return choice

    def _move_and_look(self, choice: Choice) -> None:
        """Move the camera to the view that was chosen, and look from there."""
        target = choice.target
        if choice.pose is None or choice.route is None or target is None:
            raise TypeError("there is no view to move to")
        watch = self._watch(self.control.interrupted, self.task.max_drift)
        problem = self._mover.bring_camera(choice.route, target, watch)
        if problem and not self.control.interrupted():
            if watch.reason:
                problem = f"{problem}: {watch.reason}"
            if watch.rejects_view or not watch.reason:
                self._planner.failed(FailedView(choice.pose, problem))
            if not watch.reason:
                self._fail(problem)
                return
            self._log.write("message", text=problem, level="info")
            self.look()
            return
        if problem:
            return
        self.look()
        miss = "" if self.control.interrupted() else self._mover.miss
        if miss or self._return.is_due:  # else it promises the same again
            self._planner.failed(FailedView(choice.pose, miss or self.last_reason, reached=True))

    def follow(self, route: Route, interrupted: Interrupted) -> str:
        """Move arm, base and arm; returns empty, or why it did not come to the end."""
        return self._mover.follow(route, interrupted)

    def go_to(self, place: KnownPlace, interrupted: Interrupted) -> str:
        """Go to where the robot has stood; returns empty, or why it did not get there."""
        choice = self._planner.route_to(self._robot.state(), place)
        problem, route = choice.reason, choice.route
        if route is not None:
            watch = self._watch(interrupted)
            problem = self._mover.bring_camera(route, route.T_map_camera, watch)
            problem = f"{problem}: {watch.reason}" if problem and watch.reason else problem
        self._log.write("motion", action=place.name, outcome=problem, path=[])
        return problem

    def _watch(self, interrupted: Interrupted, max_drift: float | None = None) -> MotionWatch:
        """Watches the motion that begins now."""
        return MotionWatch(self._robot, self._planner, interrupted, max_drift)

    def _fail(self, reason: str) -> None:
        """Count a failure."""
        self._failures.count(reason)
        self.last_reason = reason
        self._log.write("message", text=reason, level="warning")

    def _step(self) -> None:
        now = self._clock()
        self.mission.seconds += 0.0 if self._marked is None else max(now - self._marked, 0.0)
        self._marked = now
        self._on_step(self)


class MotionWatch:
    """What breaks one motion off: called as one asks whether the motion is interrupted.

    That is the user; a route that is not free any more in the map as it is now; and a robot whose
    place is known much less well than when the motion began.

    Args:
        robot: that moves.
        planner: knows the map, and the route that it planned last.
        interrupted: by the user.
        max_drift: that the standard deviation of its position may grow [m]; None for any.

    Attributes:
        reason: why the motion is broken off, but for the user; empty where it is not.
        rejects_view: whether that speaks against the view.
    """

    def __init__(
        self, robot: Robot, planner: Planner, interrupted: Interrupted, max_drift: float | None
    ) -> None:
        self._robot, self._planner, self._interrupted = robot, planner, interrupted
        self._most = np.inf if max_drift is None else _base_sigma(robot.state()) + max_drift
        self.reason, self.rejects_view = "", False

    def __call__(self) -> bool:
        """Whether the motion is to be broken off."""
        if self._interrupted():  # where the robot is may not be known any more
            return True
        if not self.reason and _base_sigma(self._robot.state()) > self._most:
            self.reason = "where the robot is has become too uncertain"
        if not self.reason:
            self.reason = self._planner.route_problem(self._robot.state())
            self.rejects_view = bool(self.reason)
        return bool(self.reason)


def _base_sigma(state: RobotState) -> float:
    """How well it is known where the base is [m]."""
    return base_sigma(state.T_map_camera, state.pose_covariance, state.T_map_base, 0.0)


_MOTIONS = 4  # planned again to one view: arm, and where need be base, arm, and arm once more


class CameraMover:
    """Has the robot carry out routes.

    Args:
        robot: that moves.
        planner: plans the rest of the route from where the base has come to stand.
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

        The base may stop beside the end of its path: the rest of the route is planned, and checked
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
        if route.partial and not route.arm_after.moves:  # the arm stays folded
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
        self._mission.distance += path_length(motion.path)
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
