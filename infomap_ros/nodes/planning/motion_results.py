"""What robot_driver says became of the motions that were commanded."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable

from diagnostic_msgs.msg import DiagnosticArray

from infomap_ros.nodes.common import qos
from infomap_ros.nodes.common.base import MonitoredNode
from infomap_ros.nodes.driving.motion_result import TOPIC, MotionResult, read_motion_result

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

    def of_path(self, stamp: int) -> MotionResult | None:
        """The result of the path with this stamp [ns]; None where none has come."""
        return self._find(lambda result: result.stamp == stamp)

    def of_trajectory(self, label: str) -> MotionResult | None:
        """The result of the trajectory with this label; None where none has come."""
        return self._find(lambda result: result.label == label)

    def _find(self, fits: Callable[[MotionResult], bool]) -> MotionResult | None:
        with self._lock:
            return next(filter(fits, self._newest), None)

    def _on_result(self, message: DiagnosticArray) -> None:
        result = read_motion_result(message)
        with self._lock:
            self._newest.append(result)
        self._notify()
