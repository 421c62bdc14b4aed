"""A motion as goals of action servers: some at the same time, some after others.

One goal on one action server, from its sending to its end.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

from action_msgs.msg import GoalStatus
from action_msgs.srv import CancelGoal
from rclpy.action import ActionClient
from rclpy.clock import Clock, ClockType

from infomap_ros.nodes.common.base import MonitoredNode
from infomap_ros.nodes.driving.motion_result import Order, Outcome

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


REPLACED = "a newer command has taken its place"
_PERIOD = 0.2  # [s] between two looks after servers that have gone


class _Motion:
    """An order with the goals that are running for it and those that follow."""

    def __init__(self, order: Order, stages: Sequence[Sequence[GoalRequest]]) -> None:
        self.order, self.stages = order, list(stages)
        self.goals: list[ActionGoal] = []
        self.canceled = False
        self.culprit: ActionGoal | None = None  # the first that did not succeed

    @property
    def is_waiting(self) -> bool:
        """Whether no goal was sent yet."""
        return not self.goals


class ActionMotions:
    """Carries out one motion at a time; a new one takes the place of the one before.

    A motion is done when all its goals have succeeded. Where one does not, the others are canceled,
    and it ends when all have ended. Goals of a motion that was replaced are left to their servers
    to replace; where a server refuses to, they are canceled.

    A driver that was killed leaves goals that run on and nobody knows: at the start, and whenever
    something is to stop, the servers are asked to cancel all that they have. Servers need not take
    such a request before a goal that is sent later: goals wait for its answer.

    Args:
        node: whose executor serves the clients.
        actions: names of the actions that goals are sent to.
    """

    def __init__(self, node: MonitoredNode, actions: Iterable[str]) -> None:
        self._log, self._clock = node.get_logger(), node.motion_clock
        self._steady = Clock(clock_type=ClockType.STEADY_TIME)
        self._motion: _Motion | None = None
        self._replaced: list[ActionGoal] = []
        self._cancels = {
            name: node.create_client(CancelGoal, f"{name}/_action/cancel_goal") for name in actions
        }
        self._new = set(self._cancels)  # servers that nothing was asked of yet
        self._asked: dict[Any, int] = {}  # requests to cancel all, and when they are given up
        node.repeat(_PERIOD, self._check)

    def start(self, order: Order, stages: Sequence[Sequence[GoalRequest]]) -> None:
        """Begin a motion.

        Args:
            order: whose result it reports.
            stages: goals; those of one stage run together, stages one after the other.
        """
        requests = [request for stage in stages for request in stage]
        gone = [each.name for each in requests if not each.client.server_is_ready()]
        if gone:
            self.stop("a newer command could not be carried out")
            missing = ", ".join(dict.fromkeys(gone))
            order.end(Outcome.FAILED, f"there is no action server of {missing}")
            return
        before, self._motion = self._motion, _Motion(order, stages)
        if before is not None:
            before.order.end(Outcome.CANCELED, REPLACED)
            clients = [request.client for request in stages[0]]
            for goal in before.goals:
                if goal.has_ended:
                    continue
                self._replaced.append(goal)
                if goal.request.client not in clients:
                    goal.cancel(REPLACED)
        self._new.clear()  # servers replace what they have
        self._begin()

    def stop(self, cause: str) -> None:
        """Cancel what runs; its order ends when the servers have confirmed.

        Args:
            cause: why, for the result.
        """
        motion = self._motion
        goals = list(self._replaced)
        if motion is not None:
            motion.canceled = True
            goals += motion.goals
        for goal in goals:
            goal.cancel(cause)
        self._cancel_all(self._cancels)
        if motion is not None and motion.is_waiting:
            self._motion = None
            motion.order.end(Outcome.CANCELED, cause)

    def _cancel_all(self, names: Iterable[str]) -> None:
        """Ask servers to cancel whatever they have, by a request without a goal's id."""
        for name in names:
            client = self._cancels[name]
            if client.service_is_ready():
                self._new.discard(name)
                future = client.call_async(CancelGoal.Request())
                self._asked[future] = self._steady.now().nanoseconds + int(_ANSWER * _NANOSECONDS)
                future.add_done_callback(partial(self._on_canceled, name))

    def _on_canceled(self, name: str, future: Any) -> None:
        response, known = future.result(), bool(self._running())
        if response.return_code == CancelGoal.Response.ERROR_REJECTED:
            self._log.error(f"{name} refuses to stop")
        elif response.goals_canceling and not known:
            count = len(response.goals_canceling)
            self._log.warning(f"{name}: {count} goals were running that this node has not sent")
        self._asked.pop(future, None)
        self._begin()

    @property
    def is_active(self) -> bool:
        """Whether a motion has begun that has not ended."""
        waits = self._motion is not None and self._motion.is_waiting
        return waits or bool(self._running())

    def _running(self) -> list[ActionGoal]:
        """Goals that have been sent and not ended."""
        goals = [] if self._motion is None else self._motion.goals
        return [goal for goal in (*goals, *self._replaced) if not goal.has_ended]

    def _begin(self) -> None:
        """Send the first goals of a motion, once nothing that was asked could cancel them."""
        if self._motion is not None and self._motion.is_waiting and not self._asked:
            self._send_next(self._motion)

    def _send_next(self, motion: _Motion) -> None:
        stage = motion.stages.pop(0)
        motion.goals = []
        for request in stage:
            motion.goals.append(ActionGoal(request, self._steady, self._clock, self._on_end))

    def _on_end(self, goal: ActionGoal) -> None:
        name, motion = goal.request.name, self._motion
        if goal in self._replaced:
            self._replaced.remove(goal)
            self._log.info(f"{name}, replaced: {goal.words}")
            return
        if motion is None or goal not in motion.goals:
            return
        if not goal.succeeded and not motion.canceled:
            self._log.warning(f"{name}: {goal.words}")
            motion.culprit = motion.culprit or goal
            for other in (*motion.goals, *self._replaced):
                other.cancel(f"{name} has failed")
        if all(each.has_ended for each in motion.goals):
            self._finish(motion)

    def _finish(self, motion: _Motion) -> None:
        parts = {goal.request.name: goal.words for goal in motion.goals}
        if motion.culprit is None and not motion.canceled and motion.stages:
            self._send_next(motion)
            return
        self._motion = None
        lost = next((goal for goal in motion.goals if goal.is_lost), None)
        worst = motion.culprit or lost
        if worst is not None:
            motion.order.end(Outcome.FAILED, f"{worst.request.name}: {worst.words}", parts)
        elif motion.canceled:
            words = "; ".join(f"{name}: {said}" for name, said in parts.items())
            motion.order.end(Outcome.CANCELED, words, parts)
        else:
            motion.order.end(Outcome.SUCCEEDED, "", parts)

    def _check(self) -> None:
        if self._motion is None:
            self._cancel_all(tuple(self._new))
        now = self._steady.now().nanoseconds
        self._asked = {future: due for future, due in self._asked.items() if due > now}
        self._begin()
        for goal in self._running():
            goal.check()
