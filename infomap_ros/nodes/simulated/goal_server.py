"""An action server that carries out one goal at a time, a new one in place of the one before."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from rclpy.action import ActionServer, CancelResponse, GoalResponse
from rclpy.action.server import ServerGoalHandle
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.node import Node
from rclpy.task import Future


class GoalServer:
    """The server; its owner moves, and says with `end` how that ended.

    Args:
        node: that offers the action.
        action: class of the action.
        name: of the action.
        refuse: why a goal is refused, empty where it is accepted.
        begin: called with a goal that has been accepted.
        replaced: result of a goal whose place a new one takes.
    """

    def __init__(
        self,
        node: Node,
        action: Any,
        name: str,
        refuse: Callable[[Any], str],
        begin: Callable[[Any], None],
        replaced: Any,
    ) -> None:
        self._node, self._refuse, self._begin = node, refuse, begin
        self._replaced, self._name = replaced, name
        self._current: tuple[ServerGoalHandle, Future] | None = None
        # A goal that waits for its end must not keep others and cancellations from being served.
        self._server = ActionServer(
            node,
            action,
            name,
            self._execute,
            goal_callback=self._on_goal,
            cancel_callback=lambda _: CancelResponse.ACCEPT,
            callback_group=ReentrantCallbackGroup(),
        )

    @property
    def is_active(self) -> bool:
        """Whether a goal is being carried out."""
        return self._current is not None

    @property
    def is_cancel_wanted(self) -> bool:
        """Whether the goal that is being carried out is to be canceled."""
        return self._current is not None and bool(self._current[0].is_cancel_requested)

    def end(self, state: str, result: Any) -> None:
        """End the goal that is being carried out; from any thread.

        Args:
            state: succeeded, aborted or canceled.
            result: the message.
        """
        current, self._current = self._current, None
        if current is not None:
            current[1].set_result((state, result))
            self._node.executor.wake()

    def destroy(self) -> None:
        """Offer the action no longer."""
        self._server.destroy()

    def _on_goal(self, goal: Any) -> GoalResponse:
        refused = self._refuse(goal)
        if refused:
            self._node.get_logger().error(f"{self._name} refuses a goal: {refused}")
        return GoalResponse.REJECT if refused else GoalResponse.ACCEPT

    async def _execute(self, handle: ServerGoalHandle) -> Any:
        self.end("aborted", self._replaced)
        done: Future = Future(executor=self._node.executor)
        self._current = (handle, done)
        self._begin(handle.request)
        state, result = await done
        finish = {
            "succeeded": handle.succeed,
            "aborted": handle.abort,
            "canceled": handle.canceled if handle.is_cancel_requested else handle.abort,
        }
        finish[state]()
        return result
