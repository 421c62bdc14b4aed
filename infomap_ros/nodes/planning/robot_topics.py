"""The robot's topics as the exploration uses them: base_path, arm_trajectory, map_updates."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable

from diagnostic_msgs.msg import DiagnosticArray
from nav_msgs.msg import Path
from sensor_msgs.msg import PointCloud2
from trajectory_msgs.msg import JointTrajectory

from infomap_ros.errors import PoseUnavailableError
from infomap_ros.exploration.robot import Interrupted, RobotState
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.messages import POINT_CLOUD
from infomap_ros.messages.fields import MessageFields
from infomap_ros.messages.motions import encode_arm_trajectory, encode_base_path
from infomap_ros.motion.route import ArmPath
from infomap_ros.nodes.common import qos
from infomap_ros.nodes.common.base import MonitoredNode
from infomap_ros.nodes.common.message_types import RclpyMessageTypes
from infomap_ros.nodes.driving.motion_result import TOPIC, MotionResult, Outcome, read_motion_result
from infomap_ros.nodes.robot.robot_tracker import RobotTracker, RobotTrackerConfig

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
        """Whether there is a node that reports results of motions."""
        return bool(self._node.count_publishers(self._topic))

    def of(self, motion: str) -> MotionResult | None:
        """The result of a path, by its stamp, or of a trajectory, by its label; None as yet."""
        with self._lock:
            found = (r for r in self._newest if motion in (r.label, f"path {r.stamp}"))
            return next(found, None)

    def _on_result(self, message: DiagnosticArray) -> None:
        result = read_motion_result(message)
        with self._lock:
            self._newest.append(result)
        self._notify()


class RobotTopics:
    """Implements `infomap_ros.exploration.commanded_robot.RobotLink`.

    Args:
        node: publishes base_path and arm_trajectory, listens to map_updates.
        tracker: knows where the robot is.
        stopped: whether nothing is waited for any more.

    Attributes:
        fused_scans: see `RobotLink`.
    """

    def __init__(
        self, node: MonitoredNode, tracker: RobotTracker, stopped: Callable[[], bool]
    ) -> None:
        self._stopped = stopped
        self._tracker, self._map_frame = tracker, node.config(RobotTrackerConfig).map_frame
        self._clock, self._types = node.get_clock(), RclpyMessageTypes()
        self._paths = node.advertise(Path, "base_path", qos.stream(depth=1))
        self._trajectories = node.advertise(JointTrajectory, "arm_trajectory", qos.stream(depth=1))
        self._results = MotionResults(node, tracker.notify)
        self.fused_scans = self._newest_update = 0
        node.listen(PointCloud2, "map_updates", self._on_update, qos.stream(depth=200))

    def known_state(self, in_odometry: bool = False) -> RobotState | None:
        """See `RobotLink`."""
        return self._tracker.known_state(in_odometry)

    def joint_positions(self) -> dict[str, float]:
        """See `RobotLink`."""
        return self._tracker.joint_positions()

    def joint_velocities(self) -> dict[str, float]:
        """See `RobotLink`."""
        return self._tracker.joint_velocities()

    def base_speed(self) -> float:
        """See `RobotLink`."""
        return self._tracker.base_speed()

    def send_base_path(self, poses: FloatArray, in_odometry: bool) -> str:
        """See `RobotLink`."""
        frame, now = self._tracker.odom_frame if in_odometry else self._map_frame, self._now()
        self._paths.publish(encode_base_path(self._types, now, frame, poses))
        return f"path {now}"

    def send_arm_path(self, path: ArmPath) -> str:
        """See `RobotLink`."""
        label = f"trajectory {self._now()}"
        self._trajectories.publish(encode_arm_trajectory(self._types, 0, path, label=label))
        return label

    @property
    def reports_results(self) -> bool:
        """See `RobotLink`."""
        return self._results.are_offered

    def result(self, motion: str) -> str | None:
        """See `RobotLink`."""
        result = self._results.of(motion)
        if result is None:
            return None
        return "" if result.outcome is Outcome.SUCCEEDED else result.reason

    def wait_until(
        self, condition: Callable[[], bool], timeout: float, interrupted: Interrupted
    ) -> bool:
        """See `RobotLink`."""

        def broken_off() -> bool:
            try:
                return self._stopped() or interrupted()
            except PoseUnavailableError:
                return True  # what moves is stopped first; who asks again gets the reason

        return self._tracker.wait_until(condition, timeout, broken_off)

    def _now(self) -> int:
        return int(self._clock.now().nanoseconds)

    def _on_update(self, message: PointCloud2) -> None:
        stamp, _ = MessageFields(message, POINT_CLOUD).header()
        if stamp != self._newest_update:  # one scan may come in several messages
            self._newest_update = stamp
            self.fused_scans += 1
            self._tracker.notify()
