"""What an exploration does instead of the next view."""

from __future__ import annotations

from infomap_ros.exploration.control import Control, Request
from infomap_ros.exploration.mission import Mission
from infomap_ros.exploration.robot import Choice, RobotState
from infomap_ros.exploration.rules import Actions, Fallback

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
