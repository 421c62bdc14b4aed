"""The loop of Fig. 3 of Sujan and Dubowsky 2005: look, choose, move, until it is enough."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from enum import Enum

from infomap_ros.errors import InfomapError, TeammatesBusyError
from infomap_ros.exploration.control import Control, Request
from infomap_ros.exploration.drift_guard import DriftGuard
from infomap_ros.exploration.last_views import LastViews
from infomap_ros.exploration.mission import Mission
from infomap_ros.exploration.planar import way_length
from infomap_ros.exploration.progress import MapProgress
from infomap_ros.exploration.records.run_log import RunLog
from infomap_ros.exploration.robot import (
    Choice,
    FailedView,
    Interrupted,
    KnownPlace,
    Motion,
    Planner,
    Robot,
)
from infomap_ros.exploration.task import TaskConfig
from infomap_ros.exploration.way_back import WayBack
from infomap_ros.motion.route import Route


class EndReason(Enum):
    """Why an exploration has ended."""

    DONE = "done"
    NOTHING_LEFT = "nothing left worth its cost"
    BUDGET_SPENT = "budget spent"
    STOPPED = "stopped"
    FAILED = "failed"


@dataclass(frozen=True)
class Ending:
    """The end of an exploration.

    Attributes:
        reason: in one of five kinds.
        detail: in words and numbers.
    """

    reason: EndReason
    detail: str


_STOPPED = Ending(EndReason.STOPPED, "asked to")
_DRIFTED = "where the robot is has become too uncertain"
_PAUSE = 1.0  # while others move [s]


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
        self._plan_only, self._on_step, self._clock = plan_only, on_step, clock
        self._failures, self._marked = 0, clock()
        self._last_views, self._back = LastViews(task), WayBack(self.mission)

    def run(self) -> Ending:
        """Explore to the end; says why it ended.

        What goes wrong with the robot or the planner ends in an `Ending` that names it.
        """
        try:
            ending = self._explore()
        except InfomapError as error:
            stopped = self.control.request is Request.STOP  # and what was asked broken off
            ending = _STOPPED if stopped else Ending(EndReason.FAILED, str(error))
        return self.end(ending)

    def end(self, ending: Ending) -> Ending:
        """Say that it has ended, and why: `run` does so, and who finds that it cannot begin."""
        self._enter(f"ended: {ending.reason.value}", ending.detail)
        self._log.write("end", reason=ending.reason.value, detail=ending.detail)
        return ending

    def say(self, state: str, reason: str) -> None:
        """Tell what is done before it begins, and why."""
        self._enter(state, reason)

    def _explore(self) -> Ending:
        if not self.mission.home.is_known:
            self.mission.note_home(self._robot.state())
        ending = self._look()
        while ending is None:
            ending = self._obey() or self._take_next_view()
        return ending

    def _take_next_view(self) -> Ending | None:
        """Select a camera configuration, move there, acquire and merge what it sees."""
        if self._back.is_due and not self._plan_only:
            return self._go_back()
        try:
            choice = self._choose()
        except TeammatesBusyError as busy:
            self._wait_for_teammates(str(busy))
            return None
        state = _state_of(choice.progress)
        if self.task.is_met(choice.progress.known_fraction, choice.progress.mean_sigma):
            return Ending(EndReason.DONE, state)
        if self.control.interrupted():
            return None
        if choice.pose is None or choice.route is None:
            return Ending(EndReason.NOTHING_LEFT, choice.reason)
        if spent := self._spent():
            return Ending(EndReason.BUDGET_SPENT, f"{spent} used; {state}")
        if self._plan_only:
            return self._wait()
        if in_vain := self._last_views.in_vain():
            return Ending(EndReason.NOTHING_LEFT, in_vain)
        guard = DriftGuard(self._robot, self.task.most_drift, self.control.interrupted)
        problem = self.follow(choice.route, guard)
        if guard.drifted and not self.control.interrupted():
            self._log.write("message", text=f"{problem}: {_DRIFTED}", level="info")
            return self._look()
        if problem and not self.control.interrupted():
            self._planner.failed(FailedView(choice.pose, problem))
            return self._fail(problem)
        ending = None if problem else self._look()
        if self._back.is_due:
            self._planner.failed(FailedView(choice.pose, self.last_reason, reached=True))
        return ending

    def _look(self) -> Ending | None:
        """Acquire a view and have it fused."""
        self._enter("looking")
        problem = self._robot.look(self.control.interrupted)
        self._log.write("motion", action="look", outcome=problem, path=[])
        if self.control.interrupted():
            return None
        if problem:
            self._back.failed()
            return self._fail(f"look: {problem}")
        self._back.looked(self._robot.state())
        self.mission.views += 1
        self._failures = 0
        return None

    def _choose(self) -> Choice:
        """Select the next view, and write down what there is to know about the choice."""
        self._enter("choosing")
        state = self._robot.state()
        self.mission.note_look(state.T_map_camera)
        choice = self._planner.choose(state)
        self.progress, self.last_reason = choice.progress, choice.reason
        self._last_views.note(self.mission.views, choice.progress)
        account = {"views": self.mission.views, "distance": self.mission.distance}
        self._log.write("progress", **account, **asdict(choice.progress), state=self.state)
        self._log.write("decision", view=self.mission.views, **choice.explanation)
        return choice

    def follow(self, route: Route, interrupted: Interrupted) -> str:
        """Move arm, base and arm; returns empty, or why it did not come to the end."""
        robot, problem = self._robot, ""
        if route.arm_before.moves:
            problem = self._move("arm", robot.move_arm(route.arm_before, interrupted))
        if route.moves_base and not problem:
            problem = self._move("drive", robot.drive(route.base_path, interrupted))
        if route.arm_after.moves and not problem:
            problem = self._move("arm", robot.move_arm(route.arm_after, interrupted))
        return problem

    def _move(self, action: str, motion: Motion) -> str:
        if action == "drive":
            self.mission.distance += way_length(motion.path)
        self._log.write("motion", action=action, outcome=motion.outcome, path=motion.path)
        self._step()
        return f"{action}: {motion.outcome}" if motion.outcome else ""

    def _wait(self) -> Ending | None:
        """Plan only: others move the robot, which looks again after a while."""
        self._enter("waiting: plan only")
        self.control.wait(_PAUSE)
        return self._look()

    def _wait_for_teammates(self, reason: str) -> None:
        """They are at all that is left, or in the way: ask again after a while."""
        self._enter("waiting for teammates", reason)
        self.control.wait(_PAUSE)

    def _spent(self) -> str:
        """Which budgets are spent; empty where none is."""
        task, mission = self.task, self.mission
        budgets = (
            (f"{mission.views} views", mission.views >= task.max_views),
            (f"{mission.distance:.1f} m", mission.distance >= task.max_distance),
            (f"{mission.seconds:.0f} s", mission.seconds >= task.max_time),
        )
        return " and ".join(text for text, is_spent in budgets if is_spent)

    def _fail(self, reason: str) -> Ending | None:
        """Count a failure; the end where there are too many."""
        self._failures += 1
        self.last_reason = reason
        self._log.write("message", text=reason, level="warning")
        if self._failures < self.task.max_failures:
            return None
        detail = f"{self._failures} failures one after the other, the last: {reason}"
        return Ending(EndReason.FAILED, detail)

    def _obey(self) -> Ending | None:
        """Carry out what the user asks for, until that is to go on or to stop."""
        while self.control.interrupted():
            if self.control.request is Request.STOP:
                return _STOPPED
            if self.control.request is Request.HOME:
                self._go_home()
                self.control.answered(Request.HOME, Request.PAUSE)
            else:
                self._enter("paused")
                self.control.wait_while_paused()
        return None

    def _go_home(self) -> None:
        """Go to where the mission began; where that fails, say so and stay."""
        self._enter("going home")
        control = self.control
        problem = self._go_to(self.mission.home, lambda: control.request is not Request.HOME)
        self.last_reason = f"home: {problem}" if problem else "at home"

    def _go_back(self) -> Ending | None:
        """After a look that failed, look from where the last one did not."""
        self._enter("going back to the last look")
        self._back.take()
        interrupted = self.control.interrupted
        problem = self._go_to(self.mission.last_look, interrupted)
        return None if problem or interrupted() else self._look()

    def _go_to(self, place: KnownPlace, interrupted: Interrupted) -> str:
        """Go to where the robot has stood; returns empty, or why it did not get there."""
        choice = self._planner.way_to(self._robot.state(), place)
        problem = choice.reason
        if choice.route is not None:
            problem = self.follow(choice.route, interrupted)
        self._log.write("motion", action=place.name, outcome=problem, path=[])
        return problem

    def _enter(self, state: str, reason: str | None = None) -> None:
        self.state = state
        self.last_reason = self.last_reason if reason is None else reason
        self._step()

    def _step(self) -> None:
        now = self._clock()
        self.mission.seconds += now - self._marked
        self._marked = now
        self._on_step(self)


def _state_of(progress: MapProgress) -> str:
    """How much is known, and how well, in words."""
    return (
        f"{100.0 * progress.known_fraction:.1f} % of the reachable surface is known, "
        f"mean sigma {1e3 * progress.mean_sigma:.1f} mm"
    )
