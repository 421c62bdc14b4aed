"""The rules of an exploration: small objects of two kinds.

- a `StopRule` says that the exploration ends, and why;
- a `Fallback` does something else instead of the next view.

They are asked in one order, before a view is chosen and after: the first that
applies counts (`infomap_ros.exploration.loop`).

Requests of the user to a running exploration.
"""

from __future__ import annotations

import threading
from abc import ABC, abstractmethod
from dataclasses import dataclass
from enum import Enum
from typing import Protocol

import numpy as np

from infomap_ros.exploration.mission import Mission
from infomap_ros.exploration.robot import Choice, Interrupted, KnownPlace, MapProgress, RobotState
from infomap_ros.exploration.task import TaskConfig
from infomap_ros.geometry.transforms import FloatArray


class Request(Enum):
    """What the user wants."""

    RUN = "run"
    PAUSE = "pause"
    HOME = "home"
    STOP = "stop"


class Control:
    """The last request, shared by the thread that explores and those that ask of it.

    The last request counts; only STOP is final.
    """

    def __init__(self) -> None:
        self._changed = threading.Condition()
        self._request = Request.RUN

    @property
    def request(self) -> Request:
        """The request that holds now."""
        with self._changed:
            return self._request

    def ask(self, request: Request) -> bool:
        """Make a request; returns False when it comes too late, after STOP."""
        with self._changed:
            if self._request is Request.STOP:
                return request is Request.STOP
            self._request = request
            self._changed.notify_all()
            return True

    def answered(self, request: Request, then: Request) -> None:
        """Note that `request` is carried out; `then` holds unless something else was asked."""
        with self._changed:
            if self._request is request:
                self._request = then
                self._changed.notify_all()

    def interrupted(self) -> bool:
        """Whether a motion is to be broken off."""
        return self.request is not Request.RUN

    def wait(self, seconds: float) -> None:
        """Sleep, but not beyond the next request."""
        with self._changed:
            before = self._request
            self._changed.wait_for(lambda: self._request is not before, seconds)

    def wait_while_paused(self) -> Request:
        """Wait until the request is no longer PAUSE; returns it."""
        with self._changed:
            self._changed.wait_for(lambda: self._request is not Request.PAUSE)
            return self._request


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


STOPPED = Ending(EndReason.STOPPED, "by the user")
"""The user has ended it."""


class StopRule(ABC):
    """Says that the exploration ends."""

    @abstractmethod
    def ending(self, choice: Choice | None) -> Ending | None:
        """The ending, or None.

        Args:
            choice: of the next view; None before it was chosen.
        """


class Actions(Protocol):
    """What a fallback may have the exploration do."""

    @property
    def control(self) -> Control:
        """Requests of the user."""

    @property
    def mission(self) -> Mission:
        """The account so far."""

    def say(self, state: str, reason: str | None = None) -> None:
        """State what is done before it begins, and why."""

    def look(self) -> None:
        """Acquire a view and have it fused."""

    def go_to(self, place: KnownPlace, interrupted: Interrupted) -> str:
        """Go to where the robot has stood; returns empty, or why it did not get there."""


class Fallback(ABC):
    """Something else to do instead of the next view; the loop begins again after it."""

    @abstractmethod
    def applies(self, choice: Choice | None) -> bool:
        """Whether it is to be done now.

        Args:
            choice: of the next view; None before it was chosen.
        """

    @abstractmethod
    def act(self, actions: Actions) -> None:
        """Do it."""


class TaskIsMet(StopRule):
    """Expanse and resolution suffice."""

    def __init__(self, task: TaskConfig) -> None:
        self.task = task

    def ending(self, choice: Choice | None) -> Ending | None:
        """DONE, where the map at the choice is what the task asks for."""
        if choice is None:
            return None
        progress = choice.progress
        if not self.task.is_met(progress):
            return None
        return Ending(EndReason.DONE, _in_words(progress))


class StopRequested(StopRule):
    """The user asks to stop."""

    def __init__(self, control: Control) -> None:
        self._control = control

    def ending(self, choice: Choice | None) -> Ending | None:
        """STOPPED, where that was asked for."""
        return STOPPED if self._control.request is Request.STOP else None


class NoViewLeft(StopRule):
    """The planner has found no view."""

    def ending(self, choice: Choice | None) -> Ending | None:
        """NOTHING_LEFT, with the planner's reason."""
        if choice is None or (choice.pose is not None and choice.route is not None):
            return None
        return Ending(EndReason.NOTHING_LEFT, choice.reason)


class BudgetSpent(StopRule):
    """Views, distance or time are used up, and there would be more to do."""

    def __init__(self, task: TaskConfig, mission: Mission) -> None:
        self.task, self._mission = task, mission

    def ending(self, choice: Choice | None) -> Ending | None:
        """BUDGET_SPENT, with the budgets that are."""
        if choice is None:
            return None
        task, mission = self.task, self._mission
        budgets = (
            (f"{mission.views} views", mission.views >= task.max_views),
            (f"{mission.distance:.1f} m", mission.distance >= task.max_distance),
            (f"{mission.seconds:.0f} s", mission.seconds >= task.max_time),
        )
        spent = " and ".join(text for text, is_spent in budgets if is_spent)
        detail = f"{spent} used; {_in_words(choice.progress)}"
        return Ending(EndReason.BUDGET_SPENT, detail) if spent else None


class TooManyFailures(StopRule):
    """Views or motions have failed one after the other.

    Args:
        most: so many end the exploration.
    """

    def __init__(self, most: int) -> None:
        self.most, self._count, self._last = most, 0, ""

    def count(self, reason: str) -> None:
        """Something has failed."""
        self._count, self._last = self._count + 1, reason

    def reset(self) -> None:
        """A view was taken."""
        self._count = 0

    def ending(self, choice: Choice | None) -> Ending | None:
        """FAILED, with the last reason."""
        if self._count < self.most:
            return None
        detail = f"{self._count} failures one after the other, the last: {self._last}"
        return Ending(EndReason.FAILED, detail)


class UnproductiveViews(StopRule):
    """The last views have brought so little for their time that to go on is not worth it.

    What counts is how fast the entropy of the region falls, and the share of its surface rises that
    is known precisely enough, over a few views together, each against its best such rate: most of
    what is to be seen in a place is seen early, and views that fill in the rest, a tenth of a
    percent after the other, could go on for hours. A map that becomes less certain, as by a
    correction, takes nothing from what other views have brought.

    Args:
        task: what is asked for.
    """

    def __init__(self, task: TaskConfig) -> None:
        self.task = task
        self._views, self._seconds, self._state = 0, 0.0, np.zeros(2)
        self._brought: list[FloatArray] = []  # bits, share of the surface and time of each view
        self._best = np.zeros(2)

    def note(self, views: int, seconds: float, progress: MapProgress) -> None:
        """Take the state of the map after so many views, and so much time, in any unit."""
        state = np.array([-progress.entropy_bits, progress.min_fraction])
        if views > self._views > 0:
            brought = np.maximum(state - self._state, 0.0)
            self._brought.append(np.append(brought, max(seconds - self._seconds, 0.0)))
            self._best = np.maximum(self._best, self._rates(self.task.unproductive_views))
        self._views, self._seconds, self._state = views, seconds, state

    def ending(self, choice: Choice | None) -> Ending | None:
        """NOTHING_LEFT, with what the last views have brought."""
        reason = "" if choice is None else self.reason()
        return Ending(EndReason.NOTHING_LEFT, reason) if reason else None

    def reason(self) -> str:
        """How little the last views have brought; empty where it is enough."""
        count = self.task.unproductive_views
        if len(self._brought) < count or self._share(count) > self.task.min_rate:
            return ""
        bits, surface, _ = np.sum(self._brought[-count:], axis=0)
        return (
            f"the last {count} views brought {bits:.0f} bits and made {100.0 * surface:.2f} % more "
            f"of the surface known precisely, {100.0 * self._share(count):.1f} % of the best rate"
        )

    def _rates(self, count: int) -> FloatArray:
        """Bits and share of the surface per time that the last views have brought together."""
        *brought, time = np.sum(self._brought[-count:], axis=0)
        return np.array(brought) / max(float(time), 1e-3)

    def _share(self, count: int) -> float:
        """Rate of the last views as a share of the best one, of bits or surface: the larger."""
        return float((self._rates(count) / np.maximum(self._best, 1e-12)).max())


def _in_words(progress: MapProgress) -> str:
    """How much is known, and how well."""
    interest = ""
    if progress.interest_fraction < 1.0:
        interest = f"(places of interest: {100.0 * progress.interest_fraction:.1f} %), "
    return (
        f"{100.0 * progress.known_fraction:.1f} % of the reachable surface is known, "
        f"{100.0 * progress.precise_fraction:.1f} % precisely enough, {interest}"
        f"mean sigma {1e3 * progress.mean_sigma:.1f} mm"
    )


PAUSE = 1.0
"""While others move [s]."""


class UserRequests(Fallback):
    """Pauses, or goes home, until the user asks to go on or to stop.

    Args:
        control: what they ask for.
    """

    def __init__(self, control: Control) -> None:
        self._control = control

    def applies(self, choice: Choice | None) -> bool:
        """Where anything but going on is asked for."""
        return self._control.interrupted()

    def act(self, actions: Actions) -> None:
        """Carry out what is asked for."""
        control, reason = self._control, None
        while control.request in (Request.PAUSE, Request.HOME):
            if control.request is Request.HOME:
                reason = self._go_home(actions)
                control.answered(Request.HOME, Request.PAUSE)
            else:
                actions.say("paused", reason)
                reason = None
                control.wait_while_paused()

    def _go_home(self, actions: Actions) -> str:
        """Go to where the mission began; where that fails, stay; returns what came of it."""
        actions.say("going home")
        control = self._control
        problem = actions.go_to(actions.mission.home, lambda: control.request is not Request.HOME)
        return f"home: {problem}" if problem else "at home"


class ReturnToLastView(Fallback):
    """After a look that failed, goes back to where the last one did not, and looks there.

    From there known things are in view, by which a lost camera finds its place. One failed look
    sends the robot back once: where the look there fails too it goes on.

    Args:
        mission: keeps the place, so that a restarted robot knows it, too.

    Attributes:
        is_due: whether the last look failed, and the robot has not just been back.
    """

    def __init__(self, mission: Mission) -> None:
        self._mission = mission
        self.is_due = self._is_taken = False

    def looked(self, state: RobotState) -> None:
        """A look succeeded from a state."""
        self._mission.note_success(state)
        self.is_due = self._is_taken = False

    def failed(self) -> None:
        """A look failed: it is time to go back, unless that was just done."""
        self.is_due = self._mission.last_look.is_known and not self._is_taken
        self._is_taken = False

    def applies(self, choice: Choice | None) -> bool:
        """After a look that failed."""
        return self.is_due

    def act(self, actions: Actions) -> None:
        """Go back and look."""
        actions.say("going back to the last look")
        self.is_due, self._is_taken = False, True
        interrupted = actions.control.interrupted
        problem = actions.go_to(self._mission.last_look, interrupted)
        if not problem and not interrupted():
            actions.look()


class WaitForTeammates(Fallback):
    """They are at all that is left, or in the way: asks again after a while.

    Attributes:
        reason: why the last choice has to wait; empty where there was one.
    """

    reason = ""

    def applies(self, choice: Choice | None) -> bool:
        """Where the last choice has to wait."""
        return bool(self.reason)

    def act(self, actions: Actions) -> None:
        """Let a moment pass."""
        actions.say("waiting for teammates", self.reason)
        self.reason = ""
        actions.control.wait(PAUSE)


class PlanOnly(Fallback):
    """Others move the robot: looks again after a while instead of moving it."""

    def applies(self, choice: Choice | None) -> bool:
        """Where a view was chosen."""
        return choice is not None

    def act(self, actions: Actions) -> None:
        """Let a moment pass, and look."""
        actions.say("waiting: plan only")
        actions.control.wait(PAUSE)
        actions.look()
