"""Run nodes as processes where there is no ``ros2 launch``."""

from __future__ import annotations

import os
import random
import signal
import subprocess
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path

from infomap_ros.errors import ProcessError
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
        with self._log(name).open("ab" if name in self._processes else "wb") as log:
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
