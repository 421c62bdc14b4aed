"""Node processes in a graph of their own, and a watcher of it in this process.

Run nodes as processes where there is no ``ros2 launch``.

What is known of a live run, from the diagnostics of its nodes.
"""

from __future__ import annotations

import importlib.util
import os
import random
import signal
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Self

import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.executors import SingleThreadedExecutor
from rclpy.qos import QoSProfile
from std_msgs.msg import String
from std_srvs.srv import Trigger

from infomap_ros.errors import ProcessError
from infomap_ros.geometry.atomic_file import appending
from infomap_ros.nodes.common import qos
from infomap_ros.nodes.common.environment import process_environment
from infomap_ros.nodes.team.team_topics import OWN_FRAMES

_TAIL_LINES = 15


class NodeProcesses:
    """Node processes of one graph, stopped at the latest when the context is left.

    Args:
        log_folder: receives one ``<name>.log`` for each process.
        namespace: of all nodes.
        environment: default that of this process; `private_graph` makes one of its own.
    """

    def __init__(
        self,
        log_folder: Path,
        namespace: str = "/",
        environment: Mapping[str, str] | None = None,
    ) -> None:
        self._log_folder = log_folder
        self._namespace = namespace
        self._environment = process_environment(environment)
        self._processes: dict[str, subprocess.Popen[bytes]] = {}
        log_folder.mkdir(parents=True, exist_ok=True)

    def start(
        self,
        name: str,
        parameters: Mapping[str, object],
        remaps: Mapping[str, str] | None = None,
        module: str | None = None,
    ) -> int:
        """Start a node, the first time or again; its log goes on then.

        Args:
            name: of the process and, where not given otherwise, of its module in
                `infomap_ros.nodes`.
            parameters: ROS parameters: bool, numbers, strings, lists of these.
            remaps: topic names, from -> to, besides `OWN_FRAMES`.
            module: full module name.

        Returns:
            Process id.
        """
        command = [sys.executable, "-m", module or f"infomap_ros.nodes.{name}", "--ros-args"]
        for key, value in parameters.items():
            command += ["-p", f"{key}:={_as_yaml(value)}"]
        for source, target in (OWN_FRAMES | dict(remaps or {})).items():
            command += ["-r", f"{source}:={target}"]
        command += ["-r", f"__ns:={self._namespace}"]
        if name not in self._processes:
            self._log(name).unlink(missing_ok=True)
        with appending(self._log(name)) as log:
            process = subprocess.Popen(
                command,
                env=self._environment,
                stdout=log,
                stderr=subprocess.STDOUT,
                stdin=subprocess.DEVNULL,
                start_new_session=True,  # Ctrl-C reaches only us, and we end them in order
            )
        self._processes[name] = process
        return process.pid

    def status(self, name: str) -> int | None:
        """Exit status of a process, None while it runs."""
        return self._processes[name].poll()

    def wait(self, name: str, timeout: float) -> int:
        """Wait for a process to end; returns its exit status.

        Raises:
            ProcessError: it still runs after `timeout` [s].
        """
        if not _ends_within(self._processes[name], timeout):
            raise ProcessError(f"{name} still runs after {timeout:.0f} s")
        return self._processes[name].wait()

    def end(self, name: str, timeout: float = 15.0) -> None:
        """Ask a process to end.

        Raises:
            ProcessError: it still runs after `timeout` [s].
        """
        if self.status(name) is None:
            self._processes[name].send_signal(signal.SIGINT)
        self.wait(name, timeout)

    def kill(self, name: str, timeout: float = 60.0) -> None:
        """End a process at once, without a chance to tidy up.

        Raises:
            ProcessError: it still runs after `timeout` [s].
        """
        self._processes[name].kill()
        self.wait(name, timeout)

    def check(self, may_end: Sequence[str] = ()) -> None:
        """Make sure that all processes live.

        Args:
            may_end: names of those that may have ended with status 0.

        Raises:
            ProcessError: one has ended; the error holds the end of its log.
        """
        for name, process in self._processes.items():
            status = process.poll()
            if status is None or (status == 0 and name in may_end):
                continue
            lines = self._log(name).read_text(errors="replace").splitlines()[-_TAIL_LINES:]
            text = "\n  ".join(lines)
            raise ProcessError(f"{name} ended with status {status}; its last lines:\n  {text}")

    def stop(self, timeout: float = 15.0) -> dict[str, int]:
        """Ask every process to end, and end those that do not.

        Args:
            timeout: time they have [s].

        Returns:
            Exit status by name.
        """
        for number, grace in ((signal.SIGINT, timeout), (signal.SIGTERM, 5.0)):
            for process in self._processes.values():
                if process.poll() is None:
                    process.send_signal(number)
            if all(_ends_within(process, grace) for process in self._processes.values()):
                break
        for process in self._processes.values():
            if process.poll() is None:
                process.kill()
        return {name: process.wait() for name, process in self._processes.items()}

    def __enter__(self) -> NodeProcesses:
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()

    def _log(self, name: str) -> Path:
        return self._log_folder / f"{name}.log"


def private_graph() -> dict[str, str]:
    """The environment of this process, with a domain of its own on this machine only.

    A domain that the user has chosen stays.
    """
    environment = dict(os.environ)
    if "ROS_DOMAIN_ID" not in environment:
        environment["ROS_DOMAIN_ID"] = str(random.SystemRandom().randint(1, 100))
        environment["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
    return environment


def _ends_within(process: subprocess.Popen[bytes], seconds: float) -> bool:
    try:
        process.wait(seconds)
    except subprocess.TimeoutExpired:
        return False
    return True


def _as_yaml(value: object) -> str:
    """A parameter value as the ROS command line reads it."""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, (list, tuple)):
        return "[" + ", ".join(_as_yaml(element) for element in value) + "]"
    if isinstance(value, (str, Path)):
        text = str(value).replace("'", "''")
        return f"'{text}'"
    return repr(value)


@dataclass
class RunState:
    """What is known of a run so far.

    Attributes:
        figures: last diagnostic values of each node by node name, after the namespace if any.
        complaints: last diagnostic message of each node that was not ``ok``.
        updates: arrival of the last map update of each stamp [s, monotonic] by stamp [ns].
        images: arrival of each left image, likewise.
        last_progress: when a node last had more results than before [s, monotonic].
    """

    figures: dict[str, dict[str, str]] = field(default_factory=dict)
    complaints: dict[str, str] = field(default_factory=dict)
    updates: dict[int, float] = field(default_factory=dict)
    images: dict[int, float] = field(default_factory=dict)
    last_progress: float = field(default_factory=time.monotonic)

    def count(self, node: str, figure: str = "results") -> int:
        """A whole-number figure of a node, 0 while unknown."""
        return int(self.figures.get(node, {}).get(figure, "0"))

    def drops(self) -> dict[str, int]:
        """Drops of all nodes, ``node: reason`` -> count."""
        return {
            f"{node}: {name.removeprefix('dropped: ')}": int(value)
            for node, values in self.figures.items()
            for name, value in values.items()
            if name.startswith("dropped: ")
        }

    def add(self, status: DiagnosticStatus) -> None:
        """Take what a node says of itself."""
        node = status.hardware_id.strip("/")
        before = self.count(node)
        self.figures[node] = {pair.key: pair.value for pair in status.values}
        if self.count(node) > before:
            self.last_progress = time.monotonic()
        if status.message != "ok":
            self.complaints[node] = status.message


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
