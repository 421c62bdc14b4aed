"""What fiducial_localization says while it searches for the target, as the explorer sees it."""

from __future__ import annotations

from diagnostic_msgs.msg import DiagnosticStatus

from infomap_ros.exploration.commanded_robot import CommandedRobotConfig
from infomap_ros.exploration.robot import Interrupted
from infomap_ros.nodes.common import qos
from infomap_ros.nodes.common.base import MonitoredNode
from infomap_ros.nodes.locating.localization_status import (
    LOCALIZATION_STATUS,
    LocalizationState,
    read_status,
)
from infomap_ros.nodes.robot.robot_tracker import RobotTracker

_PAIRS = 2  # that are looked at in one place; the first may be from the way


class TargetSight:
    """Implements `infomap_ros.exploration.target.target_hunt.SearchSight`.

    Args:
        node: listens to localization_status.
        tracker: woken by news, and knows where odometry has the robot.
    """

    def __init__(self, node: MonitoredNode, tracker: RobotTracker) -> None:
        self._tracker, self._progress_timeout = (
            tracker,
            node.config(CommandedRobotConfig).progress_timeout,
        )
        self._last = LocalizationState(0, "", "")
        self._looks = 0
        profile = qos.latched()
        node.listen(DiagnosticStatus, LOCALIZATION_STATUS, self._on_status, profile, required=False)

    @property
    def found(self) -> bool:
        """Whether localization says anything else than that it searches."""
        return self._last.state not in ("", "searching")

    @property
    def is_wanted(self) -> bool:
        """Whether there is a target that was never seen, and odometry to look for it by."""
        is_searching = self._last.state == "searching"
        return is_searching and self._tracker.known_state(in_odometry=True) is not None

    def look(self, interrupted: Interrupted) -> str:
        """Wait until pairs from here have been looked at; empty, or why not."""
        before = self._looks

        def done() -> bool:
            return self._looks - before >= _PAIRS or self.found

        if self._tracker.wait_until(done, self._progress_timeout, interrupted) or interrupted():
            return ""
        return f"no pair was looked at within {self._progress_timeout:g} s"

    def _on_status(self, message: DiagnosticStatus) -> None:
        news = read_status(message)
        self._looks += news.stamp != self._last.stamp
        self._last = news
        self._tracker.notify()
