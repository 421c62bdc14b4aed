"""One goal on one action server, from its sending to its end."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from action_msgs.msg import GoalStatus
from rclpy.action import ActionClient
from rclpy.clock import Clock

_NANOSECONDS = 1_000_000_000
_ANSWER = 5.0  # [s] in which a server accepts or refuses a goal, or confirms that it has stopped
_STATES = {
    GoalStatus.STATUS_CANCELED: "canceled",
    GoalStatus.STATUS_ABORTED: "aborted",
    GoalStatus.STATUS_SUCCEEDED: "succeeded",
}


@dataclass(frozen=True, eq=False)
class GoalRequest:
    """A goal that is to be sent.

    Attributes:
        name: of the controller.
        client: of its action server.
        goal: the message.
        explain: error code by its name, and the text, of a result; empty where it tells of none.
        time_limit: from the sending to the result [s]; 0 for none.
    """

    name: str
    client: ActionClient
    goal: Any
    explain: Callable[[Any], str]
    time_limit: float = 0.0


class ActionGoal:
    """Sends a goal and notes how it ends. All calls are from the thread that spins the node.

    Args:
        request: the goal.
        steady: clock by which answers are awaited.
        clock: clock by which the motion is timed.
        on_end: called once at the end.

    Attributes:
        request: as given.
        has_ended: whether it is over.
        succeeded: whether it ended at its goal.
        is_lost: whether the server did not tell how it ended: what it drives may still move.
        words: how it ended.
    """

    def __init__(
        self,
        request: GoalRequest,
        steady: Clock,
        clock: Clock,
        on_end: Callable[[ActionGoal], None],
    ) -> None:
        self.request = request
        self.has_ended, self.succeeded, self.is_lost, self.words = False, False, False, ""
        self._steady, self._clock, self._on_end = steady, clock, on_end
        self._handle: Any = None
        self._canceling, self._cause = False, ""
        self._begun = clock.now().nanoseconds
        self._answer_due = self._in(_ANSWER)
        request.client.send_goal_async(request.goal).add_done_callback(self._on_answer)

    def cancel(self, cause: str) -> None:
        """Have the server stop; it ends when the server says so, or does not answer.

        Args:
            cause: why, for its words.
        """
        if self.has_ended or self._canceling:
            return
        self._canceling, self._cause = True, cause
        self._answer_due = self._in(_ANSWER)
        if self._handle is not None:
            self._cancel(self._handle)

    def _cancel(self, handle: Any) -> None:
        handle.cancel_goal_async().add_done_callback(self._on_cancel_answer)

    def _on_cancel_answer(self, future: Any) -> None:
        answer = future.result()
        none = answer.return_code == answer.ERROR_NONE and not answer.goals_canceling  # by rclpy
        if none or answer.return_code == answer.ERROR_REJECTED:
            self._lose("refuses to stop")

    def check(self) -> None:
        """Notice a server that has gone or does not answer, and a goal that takes too long."""
        if self.has_ended:
            return
        if not self.request.client.server_is_ready():
            self._lose("its action server has gone")
        elif self._answer_due and self._steady.now().nanoseconds > self._answer_due:
            what = "confirmed the stop" if self._canceling else "answered the goal"
            self._lose(f"has not {what} within {_ANSWER:g} s")
        elif self.request.time_limit and not self._canceling:
            passed = (self._clock.now().nanoseconds - self._begun) / _NANOSECONDS
            if passed > self.request.time_limit:
                self.cancel(f"no result within {self.request.time_limit:.1f} s, so stopped")

    def _in(self, seconds: float) -> int:
        return int(self._steady.now().nanoseconds + seconds * _NANOSECONDS)

    def _on_answer(self, future: Any) -> None:
        handle = future.result()
        if not handle.accepted:
            self._end(False, "refused the goal; its own log says why")
            return
        self._handle = handle
        if self._canceling or self.has_ended:
            self._cancel(handle)
        else:
            self._answer_due = 0
        handle.get_result_async().add_done_callback(self._on_result)

    def _on_result(self, future: Any) -> None:
        response = future.result()
        words = self.request.explain(response.result)
        succeeded = response.status == GoalStatus.STATUS_SUCCEEDED and not words
        state = _STATES.get(response.status, f"ended with status {response.status}")
        self._end(succeeded, ", ".join(filter(None, (self._cause, state, words))))

    def _lose(self, words: str) -> None:
        self.is_lost = True
        self._end(False, f"{words}, the robot may still move")

    def _end(self, succeeded: bool, words: str) -> None:
        if not self.has_ended:
            self.has_ended, self.succeeded, self.words = True, succeeded, words
            self._on_end(self)
