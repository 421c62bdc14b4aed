"""Node processes in a graph of their own, and a watcher of it in this process."""

from __future__ import annotations

import importlib.util
import os
import time
from collections import Counter
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Self

import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.executors import SingleThreadedExecutor
from rclpy.qos import QoSProfile
from std_msgs.msg import String
from std_srvs.srv import Trigger

from infomap_ros.errors import ProcessError
from infomap_ros.nodes.common import qos
from infomap_ros.nodes.common.environment import process_environment
from infomap_ros.nodes.live.processes import NodeProcesses, private_graph
from infomap_ros.nodes.live.run_state import RunState

_VIEWER = "web_viewer"
_PAGE_TIMEOUT = 30.0  # [s]


class LiveGraph:
    """Node processes and a watcher in this process; a context.

    Args:
        out: folder for the logs.

    Attributes:
        state: what is known of the nodes.
        pids: process ids by node name.
        may_end: names of the processes that may end while the others go on.
    """

    may_end: tuple[str, ...] = ()

    def __init__(self, out: Path) -> None:
        self.state = RunState()
        self.pids: dict[str, int] = {}
        self._watched: Counter[str] = Counter()
        environment = process_environment(private_graph())
        self._log_folder = out / "log"
        self._processes = NodeProcesses(self._log_folder, environment=environment)
        self._page: NodeProcesses | None = None  # which may end as it likes
        self._context = rclpy.Context()
        self._environment = environment

    def __enter__(self) -> Self:
        os.environ.update(self._environment)  # the watcher must live in the same graph
        rclpy.init(context=self._context, domain_id=int(self._environment["ROS_DOMAIN_ID"]))
        self._node = rclpy.create_node("infomap_watcher", context=self._context)
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self._node)
        self._node.create_subscription(
            DiagnosticArray, "/diagnostics", self._on_diagnostics, qos.stream(depth=50)
        )
        return self

    def __exit__(self, *_: object) -> None:
        self._processes.stop()
        if self._page is not None:
            self._page.stop(timeout=3.0)
        self._node.destroy_node()
        self._context.try_shutdown()

    def subscribe(
        self,
        kind: type,
        topic: str,
        receive: Callable[[Any], None],
        profile: QoSProfile | None = None,
    ) -> None:
        """Listen to a topic of the graph."""
        self._watched[topic] += 1
        self._node.create_subscription(kind, topic, receive, profile or qos.stream(depth=100))

    def publisher(self, kind: type, topic: str) -> Any:
        """A publisher of a topic of the graph, as a user or another node would have it."""
        return self._node.create_publisher(kind, topic, qos.stream())

    def open_page(
        self,
        namespace: str = "/",
        parameters: Mapping[str, object] | None = None,
        remaps: Mapping[str, str] | None = None,
    ) -> str:
        """Start web_viewer, so that the run can be watched from its first second.

        Args:
            namespace: of the robot.
            parameters: of the node.
            remaps: of its topics.

        Returns:
            Address of the page; empty where viser is not installed, or no page comes up.

        Raises:
            ProcessError: another process failed.
        """
        if importlib.util.find_spec("viser") is None:
            return ""
        found: list[str] = []
        topic = f"{namespace.rstrip('/')}/{_VIEWER}/address"
        self.subscribe(String, topic, lambda message: found.append(message.data), qos.latched())
        self._page = NodeProcesses(self._log_folder, namespace, self._environment)
        self._page.start(_VIEWER, parameters or {}, remaps)
        page, end = self._page, time.monotonic() + _PAGE_TIMEOUT

        def is_settled() -> bool:
            return bool(found) or page.status(_VIEWER) is not None or time.monotonic() > end

        self.spin_until(is_settled, "the page", 2.0 * _PAGE_TIMEOUT)
        return found[0] if found else ""

    def spin_until(
        self,
        condition: Callable[[], bool],
        what: str,
        timeout: float,
        tick: Callable[[], None] = lambda: None,
    ) -> None:
        """Watch the run until a condition holds.

        Args:
            condition: when to stop.
            what: is waited for, in words.
            timeout: [s].
            tick: called again and again, for example to show progress.

        Raises:
            ProcessError: a process failed, or the time is over.
        """
        end = time.monotonic() + timeout
        while not condition():
            self.check()
            if time.monotonic() > end:
                complaints = "; ".join(f"{n}: {text}" for n, text in self.state.complaints.items())
                raise ProcessError(f"waited {timeout:.0f} s in vain for {what}. {complaints}")
            self._executor.spin_once(timeout_sec=0.1)
            tick()

    def check(self) -> None:
        """Make sure that all processes live.

        Raises:
            ProcessError: one has ended, and may not.
        """
        self._processes.check(may_end=self.may_end)

    def spin_for(self, seconds: float, tick: Callable[[], None] = lambda: None) -> None:
        """Watch the run for some time.

        Raises:
            ProcessError: a process failed.
        """
        end = time.monotonic() + seconds
        over = seconds + 60.0
        self.spin_until(lambda: time.monotonic() >= end, "the time to pass", over, tick)

    def call(self, service: str, timeout: float = 60.0) -> str:
        """Call a Trigger service, for example ``map_fusion/save``; returns its answer.

        Raises:
            ProcessError: there is no answer or it says that it failed.
        """
        client = self._node.create_client(Trigger, service)
        self.spin_until(client.service_is_ready, f"service {service}", timeout)
        answer = client.call_async(Trigger.Request())
        self.spin_until(answer.done, f"the answer of {service}", timeout)
        response = answer.result()
        if not response.success:
            raise ProcessError(f"{service}: {response.message}")
        return str(response.message)

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        for status in message.status:
            self.state.add(status)
