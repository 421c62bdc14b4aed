"""Velocities along a path without steps, until its end or until the base is stuck."""

from __future__ import annotations

import numpy as np

from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.motion.base.path_following import PathFollower, PathFollowingConfig, wrap

_STUCK_AFTER = 4.0  # [s] of driving without progress
_PROGRESS = (0.02, 0.05)  # [m, rad]; more than the noise of a pose
_SMALL = 1e-6  # [m/s or rad/s]


class PathDriving:
    """Follows one path at a time with limited acceleration.

    Args:
        config: the limits.

    Attributes:
        problem: why the path was given up; empty where it was not.
    """

    def __init__(self, config: PathFollowingConfig) -> None:
        self._config = config
        self._follower: PathFollower | None = None
        self._speed = self._turn_rate = 0.0
        self._mark: FloatArray | None = None
        self._waited = 0.0
        self.problem = ""

    @property
    def done(self) -> bool:
        """Whether the path has been followed to its end, or left, and the base told to stand."""
        arrived = self._follower is None or self._follower.done
        return arrived and max(abs(self._speed), abs(self._turn_rate)) < _SMALL

    def follow(self, poses: FloatArray) -> None:
        """Begin a path: x, y [m], yaw [rad], shape (K, 3).

        Raises:
            InvalidInputError: as `PathFollower`.
        """
        self._follower = PathFollower(poses, self._config)
        self._mark, self._waited, self.problem = None, 0.0, ""

    def stop(self) -> None:
        """Leave the path and slow down."""
        self._follower = None

    def stand(self) -> None:
        """The base stands: leave the path, and begin the next one from rest."""
        self._follower, self._speed, self._turn_rate = None, 0.0, 0.0

    def velocity(self, pose: FloatArray, period: float) -> tuple[float, float]:
        """Next forward speed [m/s] and turn rate [rad/s].

        Args:
            pose: x, y [m], yaw [rad] of the base now, shape (3,).
            period: since the velocity before [s].
        """
        wanted = (0.0, 0.0) if self._follower is None else self._follower.velocity(pose)
        self._watch(pose, wanted, period)
        if self.problem:
            self.stand()
            return 0.0, 0.0
        config = self._config
        self._speed = _towards(self._speed, wanted[0], config.acceleration * period)
        self._turn_rate = _towards(self._turn_rate, wanted[1], config.turn_acceleration * period)
        return self._speed, self._turn_rate

    def _watch(self, pose: FloatArray, wanted: tuple[float, float], period: float) -> None:
        """Notice that the base should move and does not."""
        if self._mark is None or wanted == (0.0, 0.0) or self._has_moved(pose - self._mark):
            self._mark, self._waited = np.array(pose), 0.0
            return
        self._waited += period
        if self._waited > _STUCK_AFTER:
            self.problem = f"the base is stuck at x {pose[0]:.2f}, y {pose[1]:.2f}"

    def _has_moved(self, change: FloatArray) -> bool:
        way, turn = float(np.linalg.norm(change[:2])), abs(wrap(float(change[2])))
        return way > _PROGRESS[0] or turn > _PROGRESS[1]


def _towards(value: float, wanted: float, change: float) -> float:
    return value + float(np.clip(wanted - value, -change, change))
