"""What SIGINT and SIGTERM do to a process that runs a node, by what it is doing.

- It imports, makes the node, compiles: it ends at once and quietly, with status 0. Nothing is there
  to be saved yet, and an exception would be lost in the callbacks of the compiler.
- It spins: the request is noted, and the node ends in order.
- It ends: nothing. A terminal and a launch file may both send a signal, and the second would break
  off what the node does at its end, such as saving a map.

When it has ended, its middleware may hold it. Fast DDS 2.14 may wait for ever, on a whole core, for
a participant to be deleted while others leave, as at a Ctrl-C that reaches all nodes of a graph:
``DomainParticipant::set_listener`` waits for a callback of the discovery, which waits for what the
deletion holds. It keeps Python's lock: only a timer of POSIX, whose thread calls ``_exit``, helps.
"""

from __future__ import annotations

import ctypes
import os
import signal
import sys
from collections.abc import Callable
from pathlib import Path
from types import FrameType

EXECUTABLES = (
    "stereo_range",
    "map_fusion",
    "bag_player",
    "simulator",
    "next_best_view",
    "explorer",
    "fiducial_localization",
    "robot_driver",
    "dead_reckoning",
    "web_viewer",
)
"""Programs of this package that run a node, which are modules of `infomap_ros.nodes` too."""

_SIGNALS = (signal.SIGINT, signal.SIGTERM)
_LONGEST = 5.0  # [s]; deleting takes below 0.1 s, and whoever launched the nodes waits 5 to 10 s
_MONOTONIC, _CALLS_A_FUNCTION = 1, 2  # CLOCK_MONOTONIC and SIGEV_THREAD of Linux
_releases: list[Callable[[], object]] = []


class Interrupts:
    """The signals of this process from the making of its node on.

    Attributes:
        requested: whether the node is to end.
    """

    def __init__(self) -> None:
        self.requested = False

    def note(self) -> None:
        """From now on only note that the node is to end."""
        _releases.clear()
        _handle_by(self._note)

    def ignore(self) -> None:
        """From now on do nothing."""
        for number in _SIGNALS:
            signal.signal(number, signal.SIG_IGN)

    def _note(self, number: int, frame: FrameType | None) -> None:
        self.requested = True


def leave_at_once() -> None:
    """From now on an interrupt ends the process, after what `release_when_leaving` names."""
    _handle_by(_leave)


def release_when_leaving(release: Callable[[], object]) -> None:
    """Have something called before the process ends while it is still being made.

    Args:
        release: gives back what would outlive the process, such as shared memory.
    """
    _releases.append(release)


def runs_a_node() -> bool:
    """Whether this process was started as one of `EXECUTABLES`, by name or by ``python -m``."""
    if sys.argv and sys.argv[0] == "-m":
        words = sys.orig_argv
        module = words[words.index("-m") + 1] if "-m" in words[:-1] else ""
        return module in {f"infomap_ros.nodes.{name}" for name in EXECUTABLES}
    return bool(sys.argv) and Path(sys.argv[0]).name in EXECUTABLES


def _handle_by(handler: Callable[[int, FrameType | None], None]) -> None:
    for number in _SIGNALS:
        signal.signal(number, handler)


def _leave(number: int, frame: FrameType | None) -> None:
    for other in _SIGNALS:
        signal.signal(other, signal.SIG_IGN)
    try:
        for release in _releases:
            release()
    finally:
        os._exit(0)


class _Event(ctypes.Structure):
    """``struct sigevent`` of Linux, 64 bytes."""

    _fields_ = (
        ("value", ctypes.c_void_p),
        ("signal", ctypes.c_int),
        ("notify", ctypes.c_int),
        ("function", ctypes.c_void_p),
        ("attributes", ctypes.c_void_p),
        ("padding", ctypes.c_byte * 32),
    )


class _Times(ctypes.Structure):
    """``struct itimerspec``: seconds and nanoseconds of the interval and of the first time."""

    _fields_ = (
        ("interval", ctypes.c_long),
        ("interval_rest", ctypes.c_long),
        ("first", ctypes.c_long),
        ("first_rest", ctypes.c_long),
    )


def part_soon() -> None:
    """Have the process of a node end by itself, whatever holds it; what it had to save is saved.

    Where the process was started for something else, such as a test, nothing is done.
    """
    if runs_a_node():
        exit_within(_LONGEST)


def exit_within(seconds: float) -> None:
    """End this process with status 0 after so many seconds, if it is still there; on Linux."""
    if sys.platform != "linux":
        return
    libc = ctypes.CDLL(None)
    sys.stdout.flush()
    sys.stderr.flush()
    leave = ctypes.cast(libc._exit, ctypes.c_void_p).value  # called with the value, which is 0
    event, timer = _Event(0, 0, _CALLS_A_FUNCTION, leave, None), ctypes.c_void_p()
    if libc.timer_create(_MONOTONIC, ctypes.byref(event), ctypes.byref(timer)) == 0:
        whole = int(seconds)
        times = _Times(0, 0, whole, max(1, int(1e9 * (seconds - whole))))
        libc.timer_settime(timer, 0, ctypes.byref(times), None)
