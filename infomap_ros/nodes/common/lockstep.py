"""Simulated time that waits until every node has used what it was sent.

So a run does not depend on how fast the machine is, and two runs are the same. Each node reports,
whenever it rests, how many messages it has sent and used on each topic since it was started. The
simulator adds them up: where all that was sent on a topic has been used by each of its listeners,
nothing is under way any more, and time may pass (the vector counters of F. Mattern, "Algorithms for
distributed termination detection", Distributed Computing 2, 1987, DOI 10.1007/BF01782776).

A node whose own thread waits for time to pass (the explorer) says until which moment it has waited.
"""

from __future__ import annotations

import threading
import time
from collections import Counter
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from typing import Any

from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticStatus, KeyValue
from rclpy.node import Node
from rclpy.publisher import Publisher
from rosgraph_msgs.msg import Clock

from infomap_ros.geometry.config import check_config, setting
from infomap_ros.nodes.common import qos

REPORTS = "lockstep_reports"
TIME = "lockstep_time"

_USED, _SENT, _FOUND, _LATCHED, _WAITED = "used ", "sent ", "found by ", "latched ", "waited until"
_QUIET = 0.3  # [s] without a report, and
_SETTLING = 1.0  # [s] with all, and publishers that have found their listeners
_UNFOUND = 30.0  # [s] after which a listener is not found any more: it asks for another quality
_LOG_PERIOD = 10.0  # [s]
_LOST = 60.0  # [s] without a report after which a message that nobody has used counts as lost


@dataclass(frozen=True)
class LockstepConfig:
    """Whether a node takes part.

    Raises:
        ConfigError: a value is out of its range.
    """

    lockstep: bool = setting(
        False,
        "Report which messages have been used, for a simulator whose lockstep_nodes names this "
        "node: its time waits for that.",
    )

    def __post_init__(self) -> None:
        check_config(self)


class LockstepReporter:
    """Counts the messages of a node and reports them whenever it rests.

    Args:
        node: whose messages are counted.
        rests: whether no work is at hand besides callbacks.
    """

    def __init__(self, node: Node, rests: Callable[[], bool]) -> None:
        self._name, self._rests = node.get_fully_qualified_name(), rests
        self._counts: Counter[str] = Counter()
        self._publishers: list[Publisher] = []
        self._lock = threading.RLock()
        self._reported: Counter[str] | None = None
        self.waited_until: Callable[[], int | None] = lambda: None
        self._waited: int | None = None
        self._publisher = node.create_publisher(DiagnosticStatus, REPORTS, qos.stream(depth=500))

    def listens(self, topic: str, latched: bool) -> None:
        """The node listens to a topic, full name; where it is latched, to all that was sent."""
        with self._lock:
            self._counts[_USED + topic] += 0
            self._counts[_LATCHED + topic] = int(latched)

    def ceases(self, topic: str) -> None:
        """The node listens to a topic no longer: nobody waits for that."""
        with self._lock:
            del self._counts[_USED + topic], self._counts[_LATCHED + topic]
            self._reported = None  # counters are equal where one lacks a zero
        self.report()

    def used(self, topic: str) -> None:
        """A message was used, as far as its callback does so."""
        with self._lock:
            self._counts[_USED + topic] += 1
        self.report()

    def count(self, publisher: Publisher) -> None:
        """Count what is sent by a publisher from now on."""
        topic, publish = publisher.topic_name, publisher.publish
        self._publishers.append(publisher)

        def counted(message: Any) -> None:
            with self._lock:
                self._counts[_SENT + topic] += 1
            publish(message)
            self.report()

        publisher.publish = counted

    def counts(self) -> Counter[str]:
        """What there is to report now."""
        with self._lock:
            for one in self._publishers:
                self._counts[_FOUND + one.topic_name] = one.get_subscription_count()
            return self._counts.copy()

    def report(self, *, again: bool = False) -> None:
        """Report, where something has changed and the node rests.

        Args:
            again: also where nothing has changed, for a simulator that came up after the node.
        """
        if not self._rests():
            return
        with self._lock:
            counts, waited = self.counts(), self.waited_until()
            if not again and (counts, waited) == (self._reported, self._waited):
                return
            self._reported, self._waited = counts, waited
            values = dict(counts) if waited is None else {**counts, _WAITED: waited}
            pairs = [KeyValue(key=key, value=str(value)) for key, value in values.items()]
            self._publisher.publish(DiagnosticStatus(name=self._name, values=pairs))


class LockstepConductor:
    """Lets time pass when nothing is under way.

    Args:
        node: the simulator.
        own: its counts; a report to itself would come after what it has just sent.
        names: of the other nodes that take part, in its namespace.
        stops: whether the node ends.
    """

    def __init__(
        self, node: Node, own: LockstepReporter, names: Collection[str], stops: Callable[[], bool]
    ) -> None:
        self._node, self._own, self._stops = node, own, stops
        self._own_name = node.get_fully_qualified_name()
        base = node.get_namespace().rstrip("/")
        self._names = {f"{base}/{name}" for name in names}
        self._changed = threading.Condition()
        self._reported: dict[str, Mapping[str, int]] = {}
        self._base: dict[tuple[str, str], int] = {}
        self._last_report, self._complete = time.monotonic(), 0.0
        node.create_subscription(DiagnosticStatus, REPORTS, self._on_report, qos.stream(depth=500))
        self._publisher = node.create_publisher(Clock, TIME, qos.stream(depth=10))

    def begin(self) -> None:
        """Wait until all are there and quiet.

        What is latched has been used then. Of what is not, that which was sent before is not
        counted, and nobody waits for who begins to listen later.
        """
        self._wait(lambda: self._names <= self._reported.keys())
        self._complete = time.monotonic()
        self._wait(self._is_quiet)
        with self._changed:
            self._base = self._missing()

    def settle(self, stamp: int) -> None:
        """Wait until nothing is under way; then say so, and wait for those who act on it.

        Args:
            stamp: of the moment to which time has come [ns].
        """
        self._wait(self._is_settled_or_lost)
        now = Time(sec=stamp // 10**9, nanosec=stamp % 10**9)
        self._publisher.publish(Clock(clock=now))
        self._wait(lambda: self._have_waited(stamp) and self._is_settled_or_lost())

    @property
    def _reports(self) -> dict[str, Mapping[str, int]]:
        return {**self._reported, self._own_name: self._own.counts()}

    def _on_report(self, message: DiagnosticStatus) -> None:
        with self._changed:
            report = {pair.key: int(pair.value) for pair in message.values}
            if report == self._reported.get(message.name):
                return
            self._reported[message.name] = report
            self._last_report = time.monotonic()
            self._changed.notify_all()

    def _wait(self, condition: Callable[[], bool]) -> None:
        logged = time.monotonic()
        with self._changed:
            while not (self._stops() or condition()):
                self._changed.wait(0.05)
                if time.monotonic() - logged > _LOG_PERIOD:
                    logged = time.monotonic()
                    self._node.get_logger().info(f"time waits for {self._waited_for()}")

    def _is_quiet(self) -> bool:
        now = time.monotonic()
        passed = now - self._complete
        is_known = self._have_found_each_other() and self._have_used_what_is_latched()
        is_ready = passed > _UNFOUND or is_known
        return now - self._last_report > _QUIET and passed > _SETTLING and is_ready

    def _have_found_each_other(self) -> bool:
        """Whether each publisher has as many listeners as there are among the nodes."""
        listeners: Counter[str] = Counter()
        reports = self._reports.values()
        for report in reports:
            listeners.update(key.removeprefix(_USED) for key in report if key.startswith(_USED))
        return all(
            count >= listeners[key.removeprefix(_FOUND)]
            for report in reports
            for key, count in report.items()
            if key.startswith(_FOUND)
        )

    def _have_used_what_is_latched(self) -> bool:
        reports = self._reports
        return not any(
            missing and reports[name].get(_LATCHED + topic)
            for (name, topic), missing in self._missing().items()
        )

    def _have_waited(self, stamp: int) -> bool:
        return all(report.get(_WAITED, stamp) >= stamp for report in self._reports.values())

    def _is_settled(self) -> bool:
        missing = self._missing()
        self._base = {k: min(n, missing[k]) for k, n in self._base.items() if k in missing}
        return all(missing[key] == count for key, count in self._base.items())

    def _is_settled_or_lost(self) -> bool:
        if self._is_settled():
            return True
        if time.monotonic() - self._last_report < _LOST:
            return False
        self._node.get_logger().warning(f"counts as lost: {self._waited_for()}")
        self._base = self._missing()
        return True

    def _missing(self) -> dict[tuple[str, str], int]:
        """How many messages each node has not used yet of those sent, by node and topic."""
        sent: Counter[str] = Counter()
        reports = self._reports
        for report in reports.values():
            for key, count in report.items():
                if key.startswith(_SENT):
                    sent[key.removeprefix(_SENT)] += count
        return {
            (name, key.removeprefix(_USED)): max(sent[key.removeprefix(_USED)] - count, 0)
            for name, report in reports.items()
            for key, count in report.items()
            if key.startswith(_USED)
        }

    def _waited_for(self) -> str:
        absent = sorted(self._names - self._reported.keys())
        behind = [
            f"{name} ({topic})"
            for (name, topic), missing in self._missing().items()
            if missing > self._base.get((name, topic), missing)
        ]
        return ", ".join(absent + behind) or "what the explorer does next"


class LockstepTime:
    """The time of a simulator in lockstep, for a thread that waits for things to happen.

    Args:
        node: in lockstep.
        reporter: of the node.
        runs: whether the thread runs.

    Attributes:
        is_over: nobody waits any more.
    """

    def __init__(self, node: Node, reporter: LockstepReporter, runs: Callable[[], bool]) -> None:
        self._reporter, self._runs = reporter, runs
        self._changed = threading.Condition()
        self._begin = self._now = 0
        self._waited, self.is_over = -1, False
        reporter.waited_until = self._waited_until
        node.create_subscription(Clock, TIME, self._on_time, qos.stream(depth=10))

    @property
    def seconds(self) -> float:
        """How long time has passed [s]."""
        return 1e-9 * (self._now - self._begin)

    def wait_until(
        self, condition: Callable[[], bool], timeout: float, interrupted: Callable[[], bool]
    ) -> bool:
        """Wait until a condition holds, looked at once at each moment of the simulated time.

        Args:
            condition: as above.
            timeout: [s], simulated.
            interrupted: breaks the waiting off.
        """
        end = self._now + 1e9 * timeout
        while not condition():
            if self.is_over or interrupted() or self._now > end:
                return False
            self._let_pass()
        return True

    def stop(self) -> None:
        """Let nobody wait any more."""
        with self._changed:
            self.is_over = True
            self._changed.notify_all()

    def _let_pass(self) -> None:
        with self._changed:
            self._waited = before = self._now
        self._reporter.report()
        with self._changed:
            self._changed.wait_for(lambda: self._now > before or self.is_over)
            self._waited = -1

    def _waited_until(self) -> int | None:
        """Until when the thread has waited [ns]; -1 while it acts, None where there is none."""
        with self._changed:
            return self._waited if self._runs() else None

    def _on_time(self, message: Clock) -> None:
        with self._changed:
            self._now = message.clock.sec * 10**9 + message.clock.nanosec
            self._begin = self._begin or self._now
            self._changed.notify_all()
