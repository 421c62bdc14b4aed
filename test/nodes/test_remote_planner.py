"""How long a plan is waited for, and what is said of one that does not come."""

from __future__ import annotations

import threading
import time
from typing import Any

import numpy as np
import pytest
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.task import Future
from std_msgs.msg import Empty
from std_srvs.srv import Trigger

from infomap_ros.errors import ExplorationError
from infomap_ros.exploration.records.choice_text import choice_to_text
from infomap_ros.exploration.robot import Choice, MapProgress
from infomap_ros.nodes.common.base import MonitoredNode
from infomap_ros.nodes.planning.remote_planner import RemotePlanner, RemotePlannerConfig

PATIENCE, WORK = 2.0, 5.0  # [s]
PLAN = Choice(MapProgress(0.5, 10.0, 0.01, 100, 1000, 0.5), None, None, "all known")


class Asker(MonitoredNode):
    """A node that asks for a plan, in a thread of its own."""

    CONFIGS = ((RemotePlannerConfig, ""),)

    def __init__(self, **node_arguments: Any) -> None:
        super().__init__("asker", **node_arguments)
        self.answer: Choice | ExplorationError | None = None
        self._planner = RemotePlanner(self, lambda _: None)
        threading.Thread(target=self._ask, daemon=True).start()

    def config(self, kind: type) -> Any:
        return RemotePlannerConfig(planner_timeout=PATIENCE)

    def _ask(self) -> None:
        state: Any = None
        try:
            self.answer = self._planner.choose(state)
        except ExplorationError as error:
            self.answer = error


class SlowPlanner:
    """Works for some seconds on each plan; says so, or not."""

    def __init__(self, graph: Any, says_so: bool) -> None:
        node = graph.tester
        self._says_so, self._done = says_so, None
        self._says = graph.publisher(Empty, "next_best_view/working")
        group = ReentrantCallbackGroup()
        node.create_service(Trigger, "next_best_view/plan", self._plan, callback_group=group)
        node.create_timer(0.2, self._work)
        self._executor, self._begin = graph.executor, 0.0

    async def _plan(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        self._begin, self._done = time.monotonic(), Future(executor=self._executor)
        await self._done
        response.success, response.message = True, choice_to_text(PLAN)
        return response

    def _work(self) -> None:
        if self._done is None:
            return
        if self._says_so:
            self._says.publish(Empty())
        if time.monotonic() > self._begin + WORK:
            self._done.set_result(None)


@pytest.mark.parametrize("says_so", [True, False])
def test_a_slow_plan_is_waited_for_while_the_planner_says_that_it_works(
    graph: Any, says_so: bool
) -> None:
    SlowPlanner(graph, says_so)
    asker = graph.add(Asker)
    begin = time.monotonic()
    graph.spin_until(lambda: asker.answer is not None, "an answer")
    if says_so:
        assert time.monotonic() - begin > WORK
        assert asker.answer.reason == "all known"
        assert np.isclose(asker.answer.progress.known_fraction, 0.5)
    else:
        assert "it does not answer" in str(asker.answer)


def test_where_nobody_plans_that_is_said(graph: Any) -> None:
    asker = graph.add(Asker)
    graph.spin_until(lambda: asker.answer is not None, "an answer")
    assert "next_best_view/plan: nobody offers it" in str(asker.answer)
