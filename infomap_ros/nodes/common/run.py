"""The main function of every node.

Have kernels compiled before the first message, and say so where that takes long.
"""

from __future__ import annotations

import gc
import os
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, TypeVar

import rclpy
from numba.core.event import Event, Listener, install_listener
from rclpy._rclpy_pybind11 import RCLError
from rclpy.executors import ExternalShutdownException
from rclpy.logging import get_logger
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from rclpy.task import Future
from threadpoolctl import threadpool_limits

from infomap_ros.errors import InfomapError
from infomap_ros.nodes.common.base import MonitoredNode
from infomap_ros.nodes.common.interrupts import Interrupts, leave_at_once

# A third of the processor time that a message costs by the other one (benchmarks/executors.py).
try:
    from rclpy.experimental import EventsExecutor as QuickExecutor
except ImportError:  # before rclpy 7.1.4
    from rclpy.executors import SingleThreadedExecutor as QuickExecutor

NodeType = TypeVar("NodeType", bound=Node)

_LONGEST_SPIN = 0.5  # [s], after which an interrupt is noticed where nothing else wakes the node


def run_node(
    factory: Callable[[], NodeType],
    arguments: Sequence[str] | None = None,
    until: Callable[[NodeType], Future] | None = None,
) -> int:
    """Initialize ROS, spin one node in one thread until shut down, and clean up.

    ROS's own handling of signals is left out, because it closes the context at once: a node could
    not tell a robot to stop. `infomap_ros.nodes.common.interrupts` says what is done instead.

    Args:
        factory: makes the node; an error of the library means that it does not start.
        arguments: command line, default ``sys.argv``.
        until: gives a future at which the node ends by itself, with the exit status as result.

    Returns:
        Exit status: 0, 2 when the node could not start, or the result of the future.
    """
    leave_at_once()
    threadpool_limits(1, user_api="blas")  # its threads spin, and take the cores from the others
    node, interrupts = None, Interrupts()
    try:
        rclpy.init(
            args=None if arguments is None else list(arguments),
            signal_handler_options=SignalHandlerOptions.NO,
        )
        node = factory()
        interrupts.note()
        gc.freeze()  # what lives to the end need not be looked through again and again
        return _spin(node, interrupts, None if until is None else until(node))
    except (InfomapError, RCLError) as error:
        if node is not None:
            raise
        _refuse(error)
        return 2
    finally:
        interrupts.ignore()
        gc.unfreeze()
        if node is not None:
            node.destroy_node()
        rclpy.try_shutdown()
        if isinstance(node, MonitoredNode) and node.is_working:
            os._exit(0)  # its job would go on in what the interpreter takes down


def _spin(node: Node, interrupts: Interrupts, end: Future | None) -> int:
    """Serve the node until it is to end; returns the exit status."""
    executor = QuickExecutor()
    executor.add_node(node)
    if end is not None:
        end.add_done_callback(lambda _: executor.wake())
    try:
        while not interrupts.requested and not (end is not None and end.done()):
            executor.spin_once(timeout_sec=_LONGEST_SPIN)
    except ExternalShutdownException:
        return 0
    return int(end.result() or 0) if end is not None and end.done() else 0


def _refuse(error: Exception) -> None:
    """Say why the node does not start, in its log too where ROS has one."""
    reason = str(error).strip().splitlines()[0] if str(error).strip() else type(error).__name__
    if rclpy.ok():
        get_logger(Path(sys.argv[0]).stem).fatal(f"not started: {reason}")
    else:
        print(f"fatal: not started: {reason}", file=sys.stderr)


def prepare_kernels(node: Node, use: Callable[[], object], seconds: float) -> None:
    """Use kernels once, so that they are compiled; with the first that is not, say how long.

    Args:
        node: that says it.
        use: uses each kernel once.
        seconds: how long that takes where nothing is compiled yet, on two cores [s].
    """
    start, log = time.monotonic(), node.get_logger()
    notice = f"compiling kernels, about {seconds:.0f} s, once"
    with install_listener("numba:compile", _FirstTime(lambda: log.info(notice))):
        use()
    log.info(f"kernels ready after {time.monotonic() - start:.1f} s")


class _FirstTime(Listener):
    """Reports that a kernel is compiled: one that is in numba's cache causes no event."""

    def __init__(self, notify: Callable[[], Any]) -> None:
        self._notify, self._has_notified = notify, False

    def on_start(self, event: Event) -> None:
        if not self._has_notified:
            self._has_notified = True
            self._notify()

    def on_end(self, event: Event) -> None:
        """Nothing is to be said."""
