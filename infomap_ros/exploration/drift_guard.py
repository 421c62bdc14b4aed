"""Breaks a motion off where the robot comes to know much less well where it is."""

from __future__ import annotations

from infomap_ros.exploration.robot import Interrupted, Robot
from infomap_ros.motion.base.pose_margin import base_sigma


class DriftGuard:
    """Watches one motion: ask it as one asks whether the motion is interrupted.

    Args:
        robot: that moves.
        most_drift: that the standard deviation of its position may grow [m].
        interrupted: by the user.

    Attributes:
        drifted: whether the position has become too uncertain.
    """

    def __init__(self, robot: Robot, most_drift: float, interrupted: Interrupted) -> None:
        self._robot, self._interrupted = robot, interrupted
        self._most = self._sigma() + most_drift
        self.drifted = False

    def __call__(self) -> bool:
        """Whether the motion is to be broken off."""
        self.drifted = self.drifted or self._sigma() > self._most
        return self.drifted or self._interrupted()

    def _sigma(self) -> float:
        state = self._robot.state()
        return base_sigma(state.T_map_camera, state.pose_covariance, state.T_map_base, 0.0)
