"""What the machine did to a measurement: time that processes wanted a core and had none.

A delay that the machine made is not one of the package; with these figures one can tell.
"""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path
from types import TracebackType

_WITNESS = """
import sys, threading, time
done = threading.Event()
threading.Thread(target=lambda: (sys.stdin.read(), done.set()), daemon=True).start()
latest = 0.0
while not done.is_set():
    start = time.monotonic()
    time.sleep(0.005)
    latest = max(latest, time.monotonic() - start - 0.005)
print(latest)
"""


class Machine:
    """Watches from entering the context until `figures`.

    Args:
        pids: processes by name.
    """

    def __init__(self, pids: Mapping[str, int]) -> None:
        self._pids = pids

    def __enter__(self) -> Machine:
        command = [sys.executable, "-S", "-c", _WITNESS]
        self._witness = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )
        self._stolen = stolen_seconds()
        self._waited = {name: waited_seconds(pid) for name, pid in self._pids.items()}
        return self

    def figures(self) -> dict[str, object]:
        """The figures since the context was entered [ms].

        ``steal_ms``: cores were taken from the virtual machine. ``witness_ms``: longest that a
        process which only sleeps woke up too late. ``waited_ms``: all threads of each process
        were ready and had no core.
        """
        latest, _ = self._witness.communicate()
        waited = {n: 1e3 * (waited_seconds(self._pids[n]) - s) for n, s in self._waited.items()}
        return {
            "steal_ms": 1e3 * (stolen_seconds() - self._stolen),
            "witness_ms": 1e3 * float(latest),
            "waited_ms": waited,
        }

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if self._witness.poll() is None:
            self._witness.kill()
        self._witness.wait()


def cpu_seconds(pid: int) -> float:
    """Processor time that a process has used so far, all threads [s]."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def stolen_seconds() -> float:
    """Time for which the host has run others on the cores of this virtual machine [s]."""
    fields = Path("/proc/stat").read_text().splitlines()[0].split()
    return int(fields[8]) / os.sysconf("SC_CLK_TCK")


def waited_seconds(pid: int) -> float:
    """Time for which the threads of a process were ready to run and had to wait [s]."""
    tasks = Path(f"/proc/{pid}/task").iterdir()
    return sum(1e-9 * int((task / "schedstat").read_text().split()[1]) for task in tasks)
