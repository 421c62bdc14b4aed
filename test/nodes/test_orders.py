"""Orders that a worker carries out."""

from __future__ import annotations

import threading
from typing import Any

import pytest
from std_msgs.msg import String
from std_srvs.srv import Trigger

from infomap_ros.errors import ExplorationError
from infomap_ros.nodes.common import qos
from infomap_ros.nodes.common.base import MonitoredNode
from infomap_ros.nodes.common.orders import offer_order


class PatientNode(MonitoredNode):
    """Its order takes until a word has come."""

    def __init__(self, **node_arguments: Any) -> None:
        super().__init__("patient", **node_arguments)
        self.heard = threading.Event()
        self.refuses = False
        self.listen(String, "word", lambda _: self.heard.set(), qos.stream())
        offer_order(self, "~/wait", self.start_worker(1), self._wait)

    def _wait(self) -> str:
        if self.refuses:
            raise ExplorationError("not today")
        return "heard" if self.heard.wait(20.0) else "heard nothing"


@pytest.fixture
def node(graph: Any) -> PatientNode:
    found: PatientNode = graph.add(PatientNode)
    return found


def call(graph: Any) -> Any:
    client = graph.tester.create_client(Trigger, "patient/wait")
    graph.spin_until(client.service_is_ready, "the service")
    return client.call_async(Trigger.Request())


def test_other_callbacks_are_served_while_an_order_is_carried_out(
    graph: Any, node: PatientNode
) -> None:
    words = graph.publisher(String, "word")
    graph.connect(words)
    answer = call(graph)
    graph.spin_until(lambda: node._workers[0].waiting, "the order to be at work")
    words.publish(String(data="now"))
    graph.spin_until(answer.done, "the answer")
    assert (answer.result().success, answer.result().message) == (True, "heard")


def test_an_error_of_the_library_is_the_answer(graph: Any, node: PatientNode) -> None:
    node.refuses = True
    answer = call(graph)
    graph.spin_until(answer.done, "the answer")
    assert (answer.result().success, answer.result().message) == (False, "not today")
    assert node._workers[0].alive
