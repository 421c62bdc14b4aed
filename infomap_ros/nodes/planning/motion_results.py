"""What robot_driver says became of the motions that were commanded."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable

from diagnostic_msgs.msg import DiagnosticArray

from infomap_ros.nodes.common import qos
from infomap_ros.nodes.common.base import MonitoredNode
from infomap_ros.nodes.driving.motion_result import TOPIC, MotionResult, read_motion_result


def path_name(stamp: int) -> str:
    """How a path with this stamp [ns] is called here."""
    return f"path {stamp}"


_KEPT = 20  # results; one motion is commanded at a time


class MotionResults:
    """Listens to motion_results; callbacks of the node write, any thread reads.

    Args:
        node: that listens.
        notify: called when a result has come.
    """

    def __init__(self, node: MonitoredNode, notify: Callable[[], None]) -> None:
        self._node, self._notify = node, notify
        self._topic = node.resolve_topic_name(TOPIC)
        self._lock = threading.Lock()
        self._newest: deque[MotionResult] = deque(maxlen=_KEPT)
        node.listen(DiagnosticArray, TOPIC, self._on_result, qos.stream(), required=False)

    @property
    def are_offered(self) -> bool:
        """Whether there is a node that tells what becomes of motions."""
        return bool(self._node.count_publishers(self._topic))

    def of(self, motion: str) -> MotionResult | None:
        """The result of a path or of a trajectory, by `path_name` or label; None as yet."""
        with self._lock:
            found = (r for r in self._newest if motion in (r.label, path_name(r.stamp)))
            return next(found, None)

    def _on_result(self, message: DiagnosticArray) -> None:
        result = read_motion_result(message)
        with self._lock:
            self._newest.append(result)
        self._notify()
