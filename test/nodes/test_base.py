"""Guarded inputs, counted drops and diagnostics, over DDS."""

from __future__ import annotations

import signal
import threading
from dataclasses import dataclass
from typing import Any

import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from sensor_msgs.msg import Image
from std_msgs.msg import String

from infomap_ros.errors import CalibrationError, ConfigError
from infomap_ros.geometry.config import check_config, parameter
from infomap_ros.nodes.common import qos
from infomap_ros.nodes.common.base import MonitoredNode
from infomap_ros.nodes.common.run import run_node

SIGNALS = (signal.SIGINT, signal.SIGTERM)


@dataclass(frozen=True)
class EchoConfig:
    prefix: str = parameter(">", "What comes first.", choices=(">", "<"))

    def __post_init__(self) -> None:
        check_config(self)


class EchoNode(MonitoredNode):
    """Echoes what it hears; refuses the word ``bad``."""

    CONFIGS = ((EchoConfig, ""),)

    def __init__(self, **node_arguments: Any) -> None:
        super().__init__("echo", **node_arguments)
        self.heard: list[str] = []
        self.listen(String, "words", self._on_word, qos.stream())
        self.listen(String, "silence", self._on_word, qos.sensor_data())

    def _on_word(self, message: String) -> None:
        if message.data == "bad":
            raise CalibrationError("bad word")
        self.heard.append(self.config(EchoConfig).prefix + message.data)
        self.health.produced()


def values_of(status: DiagnosticStatus) -> dict[str, str]:
    return {pair.key: pair.value for pair in status.values}


def test_an_error_of_the_library_is_a_counted_drop_and_the_node_goes_on(graph: Any) -> None:
    node = graph.add(EchoNode)
    words = graph.publisher(String, "words")
    graph.connect(words)

    for word in ("one", "bad", "two"):
        words.publish(String(data=word))

    graph.spin_until(lambda: len(node.heard) == 2, "two words")
    assert node.heard == [">one", ">two"]
    assert node.health.drops() == {"calibration": 1}


def test_diagnostics_tell_drops_rates_and_ages(graph: Any) -> None:
    node = graph.add(EchoNode)
    words = graph.publisher(String, "words")
    arrays = graph.collect(DiagnosticArray, "/diagnostics")
    graph.connect(words)
    words.publish(String(data="bad"))
    graph.spin_until(lambda: node.health.drops(), "a drop")

    def found() -> list[DiagnosticStatus]:
        name = node.get_fully_qualified_name()
        statuses = [s for array in arrays for s in array.status if s.hardware_id == name]
        return [s for s in statuses if "dropped: calibration" in values_of(s)]

    graph.spin_until(found, "diagnostics with the drop")
    status = found()[0]
    values = values_of(status)
    assert status.level == DiagnosticStatus.WARN
    assert "dropped 1: calibration" in status.message
    assert "bad word" in values["last drop: calibration"]
    assert values[f"{graph.namespace}/words count"] == "1"
    assert values[f"{graph.namespace}/silence age [s]"] == "never"


def test_an_input_without_messages_is_named_in_diagnostics(graph: Any) -> None:
    node = graph.add(EchoNode)
    arrays = graph.collect(DiagnosticArray, "/diagnostics")

    def complaints() -> str:
        return " ".join(s.message for array in arrays for s in array.status)

    graph.spin_until(lambda: f"{graph.namespace}/silence yet" in complaints(), "a complaint")
    assert node.health.missing() == [f"{graph.namespace}/words", f"{graph.namespace}/silence"]


def test_two_sources_of_one_sensor_are_named_in_diagnostics(graph: Any) -> None:
    """Two simulators, or a driver that was started twice: images of two worlds would mix."""

    class Watcher(MonitoredNode):
        def __init__(self, **node_arguments: Any) -> None:
            super().__init__("watcher", **node_arguments)
            self.listen(Image, "left/image_raw", lambda _: None, qos.sensor_data())
            self.listen(String, "words", lambda _: None, qos.stream())

    graph.add(Watcher)
    arrays = graph.collect(DiagnosticArray, "/diagnostics")
    for topic, kind in (("left/image_raw", Image), ("words", String)):
        graph.publisher(kind, topic)
        graph.publisher(kind, topic)
    tester = graph.tester.get_fully_qualified_name()
    said = f"{graph.namespace}/left/image_raw is published by {tester} and {tester}"

    def complaints() -> str:
        return " ".join(s.message for array in arrays for s in array.status)

    graph.spin_until(lambda: said in complaints(), "a complaint")
    assert "words is published" not in complaints()


def test_an_impossible_parameter_keeps_the_node_from_starting(graph: Any) -> None:
    with pytest.raises(ConfigError, match="'prefix'"):
        graph.add(EchoNode, prefix="?")


def test_a_node_that_cannot_start_ends_with_one_line(capfd: pytest.CaptureFixture) -> None:
    def refuse() -> Any:
        raise ConfigError("rate", -1.0, "a positive number")

    before = [signal.getsignal(number) for number in SIGNALS]
    status = run_node(refuse, [])
    wrong = run_node(refuse, ["--ros-args", "--params-file", "nowhere.yaml"])
    for number, handler in zip(SIGNALS, before, strict=True):
        signal.signal(number, handler)

    assert (status, wrong) == (2, 2)
    said = capfd.readouterr().err
    assert "parameter 'rate' is -1.0" in said
    assert "nowhere.yaml" in said
    assert "Traceback" not in said


def test_an_input_that_never_comes_is_named_with_all_that_is_known(
    graph: Any, capfd: pytest.CaptureFixture
) -> None:
    node = graph.add(EchoNode)
    graph.publisher(String, "silence")
    topic = f"{graph.namespace}/silence"
    graph.spin_until(lambda: node.count_publishers(topic), "the publisher")
    node.health._streams[topic].since -= 10.0
    said = ""

    def read() -> bool:
        nonlocal said
        said += capfd.readouterr().err
        return "infomap doctor" in said

    graph.spin_until(read, "a warning")

    assert f"{topic} (std_msgs/msg/String, best effort, 1 publisher)" in said
    assert "words" not in said, "five seconds have not passed"


def test_a_parameter_with_a_slip_of_the_pen_is_named(
    graph: Any, capfd: pytest.CaptureFixture
) -> None:
    graph.add(EchoNode, prefx="<")

    assert "parameter prefx is not known and not used: is prefix meant?" in capfd.readouterr().err


def test_a_defect_in_the_worker_ends_the_node(graph: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(threading, "excepthook", lambda _: None)
    worker = graph.add(EchoNode).start_worker(1)
    worker.submit(lambda: 1 / 0)

    with pytest.raises(RuntimeError, match="worker"):
        graph.spin_until(lambda: False, "the end", timeout=10.0)


def test_a_defect_that_a_message_of_a_peer_meets_is_one_counted_drop(graph: Any) -> None:
    node = graph.add(EchoNode)
    worker = node.start_worker(1)
    heard: list[str] = []

    def hear(message: String) -> None:
        heard.append(message.data)
        ([] if message.data == "bad" else [message.data])[0]

    def hear_later(message: String) -> None:
        worker.submit_always(lambda: node.guard_peer("later", lambda: hear(message)))

    node.listen(String, "now", hear, qos.stream(), required=False, from_peer=True)
    node.listen(String, "later", hear_later, qos.stream(), required=False, from_peer=True)
    publishers = [graph.publisher(String, topic) for topic in ("now", "later")]
    graph.connect(*publishers)

    for publisher in publishers:
        for word in ("bad", "good"):
            publisher.publish(String(data=word))

    graph.spin_until(lambda: heard.count("good") == 2, "what came after the bad words")
    assert node.health.drops() == {"failed: IndexError": 2}
    assert "test_base.py, line" in node.health.values()["last drop: failed: IndexError"]
    assert worker.alive


def test_quality_of_service_can_be_overridden(graph: Any) -> None:
    topic = f"{graph.namespace}/silence"
    graph.add(EchoNode, **{f"qos_overrides.{topic}.subscription.reliability": "reliable"})

    (info,) = graph.tester.get_subscriptions_info_by_topic(topic)
    assert info.qos_profile.reliability == qos.stream().reliability


def test_what_a_drop_tells_is_one_printable_line(
    graph: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    node = graph.add(EchoNode)
    lines: list[str] = []
    logger = type(node.get_logger())
    monkeypatch.setattr(logger, "warning", lambda _self, text, **_how: lines.append(text))
    node.drop("odd", "\x1b[2J\n[INFO] all is well" + 5_000_000 * "x")
    assert len(lines) == 1 and len(lines[0]) < 700 and lines[0].isprintable()
    assert lines[0].startswith("dropped (odd) \\x1b[2J\\n[INFO] all is well")
    told = node.health.values()["last drop: odd"]
    assert told.isprintable() and len(told) < 600
