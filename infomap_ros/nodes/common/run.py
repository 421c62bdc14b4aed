"""The main function of every node."""

from __future__ import annotations

import gc
import signal
import sys
from collections.abc import Callable, Sequence
from typing import TypeVar

import rclpy
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from rclpy.task import Future
from threadpoolctl import threadpool_limits

from infomap_ros.errors import InfomapError

NodeType = TypeVar("NodeType", bound=Node)


def run_node(
    factory: Callable[[], NodeType],
    arguments: Sequence[str] | None = None,
    until: Callable[[NodeType], Future] | None = None,
) -> int:
    """Initialise ROS, spin one node in one thread until shut down, and clean up.

    Only the first interrupt counts: a terminal and a launch file may both send one, and the second
    would break off what the node does at its end, such as saving a map. ROS's own handling of
    signals is left out, because it closes the context at once: a node could not tell a robot to
    stop.

    Args:
        factory: makes the node; an error of the library means that it does not start.
        arguments: command line, default ``sys.argv``.
        until: gives a future at which the node ends by itself, with the exit status as result.

    Returns:
        Exit status: 0, 2 when the node could not start, or the result of the future.
    """
    threadpool_limits(1, user_api="blas")  # its threads spin, and take the cores from the others
    rclpy.init(
        args=None if arguments is None else list(arguments),
        signal_handler_options=SignalHandlerOptions.NO,
    )
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, interrupt)
    node = None
    try:
        node = factory()
        gc.freeze()  # what lives to the end need not be looked through again and again
        executor = SingleThreadedExecutor()
        executor.add_node(node)
        if until is None:
            executor.spin()
        else:
            executor.spin_until_future_complete(end := until(node))
            return int(end.result() or 0)
    except InfomapError as error:
        print(f"fatal: not started: {error}", file=sys.stderr)
        return 2
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    finally:
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        signal.signal(signal.SIGTERM, signal.SIG_DFL)
        gc.unfreeze()
        if node is not None:
            node.destroy_node()
        rclpy.try_shutdown()
    return 0


def interrupt(number: int, frame: object) -> None:
    """Handle a signal by breaking off; a node's timers wake it often enough to notice."""
    raise KeyboardInterrupt
