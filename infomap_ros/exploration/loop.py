"""The loop of Fig. 3 of Sujan and Dubowsky 2005: look, fuse, rate, choose, move.

What ends the loop, what it does instead of the next view, and what breaks a motion off are rules
(`infomap_ros.exploration.rules`), listed in `Exploration.__init__` in the order in which they
count.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import asdict

from infomap_ros.errors import InfomapError, TeammatesBusyError
from infomap_ros.exploration.camera_mover import CameraMover
from infomap_ros.exploration.control import Control, Request
from infomap_ros.exploration.fallbacks import (
    PlanOnly,
    ReturnToLastView,
    UserRequests,
    WaitForTeammates,
)
from infomap_ros.exploration.mission import Mission
from infomap_ros.exploration.progress import MapProgress
from infomap_ros.exploration.records.run_log import RunLog
from infomap_ros.exploration.robot import (
    Choice,
    FailedView,
    Interrupted,
    KnownPlace,
    Planner,
    Robot,
)
from infomap_ros.exploration.rules import (
    STOPPED,
    BudgetSpent,
    Ending,
    EndReason,
    Fallback,
    MotionMonitor,
    NoViewLeft,
    StopRequested,
    StopRule,
    TaskIsMet,
    TooManyFailures,
    UnproductiveViews,
)
from infomap_ros.exploration.task import TaskConfig
from infomap_ros.motion.base.pose_margin import base_sigma
from infomap_ros.motion.route import Route

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
        clock: seconds; only differences count.

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
        self._on_step, self._clock, self._marked = on_step, clock, clock()
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
        self._route_monitor = RouteMonitor(robot, planner)
        self._drift_monitor = DriftMonitor(robot, task.max_drift)
        self._monitors = [self._drift_monitor, self._route_monitor]

    def change_task(self, task: TaskConfig) -> None:
        """Go on by another task, also from another thread: the next step counts by it."""
        self.task = self._mover.task = task
        self._is_met.task = self._budget.task = self._unproductive.task = task
        self._failures.most, self._drift_monitor.max_drift = task.max_failures, task.max_drift

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
        watch = MotionWatch(self._monitors, self.control.interrupted)
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
        choice = self._planner.way_to(self._robot.state(), place)
        problem, route = choice.reason, choice.route
        if route is not None:
            watch = MotionWatch([self._route_monitor], interrupted)
            problem = self._mover.bring_camera(route, route.T_map_camera, watch)
            problem = f"{problem}: {watch.reason}" if problem and watch.reason else problem
        self._log.write("motion", action=place.name, outcome=problem, path=[])
        return problem

    def _fail(self, reason: str) -> None:
        """Count a failure."""
        self._failures.count(reason)
        self.last_reason = reason
        self._log.write("message", text=reason, level="warning")

    def _step(self) -> None:
        now = self._clock()
        self.mission.seconds += now - self._marked
        self._marked = now
        self._on_step(self)


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
