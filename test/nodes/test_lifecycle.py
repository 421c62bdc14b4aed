"""A lifecycle manager brings nodes up and down, by the services of lifecycle_msgs."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import Twist
from lifecycle_msgs.msg import State, Transition
from lifecycle_msgs.srv import ChangeState, GetState
from std_msgs.msg import String

from infomap_ros.nodes.common import qos
from infomap_ros.nodes.common.base import MonitoredNode

from .test_explorer import Stage
from .test_robot_driver import FAST, VelocityBench


class Echo(MonitoredNode):
    """Publishes what it hears."""

    def __init__(self, **arguments: Any) -> None:
        super().__init__("echo", **arguments)
        said = self.advertise(String, "said", qos.stream())
        self.listen(String, "asked", said.publish, qos.sensor_data())
        self.listen(String, "described", said.publish, qos.latched())


class Manager:
    """Asks a node for its state, and for others."""

    def __init__(self, graph: Any, node: str) -> None:
        self._graph = graph
        self._get = graph.tester.create_client(GetState, f"{node}/get_state")
        self._change = graph.tester.create_client(ChangeState, f"{node}/change_state")
        ready = (self._get.service_is_ready, self._change.service_is_ready)
        graph.spin_until(lambda: all(each() for each in ready), "the services")

    def state(self) -> int:
        return int(self._answer(self._get, GetState.Request()).current_state.id)

    def change(self, transition: int) -> bool:
        request = ChangeState.Request(transition=Transition(id=transition))
        return bool(self._answer(self._change, request).success)

    def _answer(self, client: Any, request: Any) -> Any:
        future = client.call_async(request)
        self._graph.spin_until(future.done, "the answer")
        return future.result()


def test_a_node_is_active_from_its_start(graph: Any) -> None:
    graph.add(Echo)
    assert Manager(graph, "echo").state() == State.PRIMARY_STATE_ACTIVE


def test_a_manager_brings_a_node_up_and_down(graph: Any) -> None:
    node = graph.add(Echo, start_active=False)
    manager = Manager(graph, "echo")
    heard = graph.collect(String, "said")
    asked = graph.publisher(String, "asked")
    described = graph.tester.create_publisher(String, "described", qos.latched())
    graph.connect(asked, described)
    topic = node.resolve_topic_name("asked")

    def ask(word: str) -> None:
        before = node.health.values()[f"{topic} count"]
        asked.publish(String(data=word))
        graph.spin_until(lambda: node.health.values()[f"{topic} count"] != before, word)

    assert manager.state() == State.PRIMARY_STATE_UNCONFIGURED
    assert manager.change(Transition.TRANSITION_CONFIGURE)
    described.publish(String(data="latched"))
    ask("too early")
    assert manager.state() == State.PRIMARY_STATE_INACTIVE
    assert heard == []

    assert manager.change(Transition.TRANSITION_ACTIVATE)
    ask("now")
    graph.spin_until(lambda: len(heard) == 2, "both")
    assert [message.data for message in heard] == ["latched", "now"]

    assert manager.change(Transition.TRANSITION_DEACTIVATE)
    ask("too late")
    assert manager.change(Transition.TRANSITION_CLEANUP)
    assert manager.state() == State.PRIMARY_STATE_UNCONFIGURED
    assert manager.change(Transition.TRANSITION_CONFIGURE)
    assert manager.change(Transition.TRANSITION_ACTIVATE)
    ask("again")
    graph.spin_until(lambda: len(heard) == 3, "the last one")
    assert heard[-1].data == "again"
    assert manager.change(Transition.TRANSITION_ACTIVE_SHUTDOWN)
    assert manager.state() == State.PRIMARY_STATE_FINALIZED


def test_an_inactive_node_misses_nothing_and_says_what_it_is(graph: Any) -> None:
    said = graph.collect(DiagnosticArray, "/diagnostics")
    graph.add(Echo, start_active=False)
    graph.spin_until(lambda: said, "diagnostics")
    (status,) = said[-1].status
    assert (status.level, status.message) == (DiagnosticStatus.OK, "inactive")


def test_a_base_stands_still_while_its_driver_is_inactive(graph: Any) -> None:
    bench = VelocityBench(graph, Twist, base="cmd_vel", **FAST)
    bench.base.patience = 1e9  # a base that goes on by its last velocity
    manager = Manager(graph, "robot_driver")
    bench.drive((0, 0, 0), (9, 0, 0))
    graph.spin_until(lambda: bench.base.pose[0] > 0.3, "motion")
    assert manager.change(Transition.TRANSITION_DEACTIVATE)
    graph.spin_until(lambda: bench.base.commands[-1] == (0.0, 0.0), "stop")
    bench.drive((0, 0, 0), (9, 0, 0))  # is not obeyed
    assert manager.change(Transition.TRANSITION_ACTIVATE)
    sent = bench.drive((0, 0, 0), (9, 0, 0))
    graph.spin_until(lambda: bench.base.commands[-1][0] > 0.1, f"the drive {sent}")


def test_an_inactive_explorer_neither_moves_nor_begins(graph: Any, tmp_path: Path) -> None:
    stage = Stage(graph, tmp_path, views=3, autostart=True, start_active=False)
    rover = stage.rover
    rover.obeys = False  # so that the mission lasts
    manager = Manager(graph, "explorer")
    refused = stage.call("start")
    assert not refused.success
    assert "inactive" in refused.message

    assert manager.change(Transition.TRANSITION_CONFIGURE)
    assert manager.change(Transition.TRANSITION_ACTIVATE)
    graph.spin_until(lambda: rover.paths and len(rover.paths[-1].poses) > 1, "a drive")
    assert manager.change(Transition.TRANSITION_DEACTIVATE)
    graph.spin_until(lambda: len(rover.paths[-1].poses) == 1, "the order to stand")
    assert stage.state().startswith("ended: stopped")
