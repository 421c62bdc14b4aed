"""What SIGINT and SIGTERM do to a process that runs a node, by what it is doing.

- It imports, makes the node, compiles: it ends at once and quietly, with status 0. Nothing is there
  to be saved yet, and an exception would be lost in the callbacks of the compiler.
- It spins: the request is noted, and the node ends in order.
- It ends: nothing. A terminal and a launch file may both send a signal, and the second would break
  off what the node does at its end, such as saving a map.
"""

from __future__ import annotations

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
