"""What the base does: drives at a velocity, follows a path, or stands; and whether it is stuck."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from infomap_ros.geometry.config import check_config
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.motion.base.path_following import PathFollower, PathFollowingConfig, wrap
from infomap_ros.simulation.body.drive_train import DriveTrain, planar

_TILT_MARGIN = 0.1  # [rad]


@dataclass(frozen=True)
class BaseMotionConfig:
    """Parameters of the watch over the base."""

    command_timeout: ClassVar[float] = 0.5
    """A velocity holds so long without being repeated [s]."""
    stuck_time: ClassVar[float] = 4.0
    """Without progress for so long it is stuck, and stops [s]."""
    stuck_distance: ClassVar[float] = 0.02
    """What counts as progress: such a way... [m]"""
    stuck_angle: ClassVar[float] = 0.05
    """...or such a turn [rad]."""

    max_tilt: ClassVar[float] = 0.45
    """Where it tilts more it stops [rad]."""

    def __post_init__(self) -> None:
        """Validate all fields."""
        check_config(self)


class BaseMotion:
    """Carries out the last command to the base.

    Args:
        drive: the wheels.
        config: the parameters.
        following: how paths are followed.
    """

    def __init__(
        self, drive: DriveTrain, config: BaseMotionConfig, following: PathFollowingConfig
    ) -> None:
        self._drive, self._config, self._following = drive, config, following
        self._follower: PathFollower | None = None
        self._path_frame: FloatArray = np.zeros(3)
        self._velocity, self._remaining = (0.0, 0.0), 0.0
        self._mark: FloatArray | None = None
        self._waited = 0.0
        self._first_tilt: float | None = None
        self.problem = ""

    @property
    def active(self) -> bool:
        """Whether the base is being driven."""
        return self._follower is not None or self._remaining > 0.0 or not self._drive.is_still

    def follow(self, poses: FloatArray, T_odom_path: FloatArray | None) -> None:
        """Follow a path.

        Args:
            poses: x, y [m], yaw [rad], shape (K, 3).
            T_odom_path: frame of the poses in odom, shape (4, 4); None where they are in odom.

        Raises:
            InvalidInputError: as `PathFollower`.
        """
        self._follower = PathFollower(poses, self._following)
        self.correct(np.eye(4) if T_odom_path is None else T_odom_path)
        self._start()

    def correct(self, T_odom_path: FloatArray) -> None:
        """Localization has found the frame of the path to be here in odom, shape (4, 4)."""
        self._path_frame = planar(T_odom_path)

    def drive(self, speed: float, turn_rate: float) -> None:
        """Drive at a velocity [m/s, rad/s] until it times out; ends the path."""
        limits = self._following
        self._velocity = (
            float(np.clip(speed, -limits.max_speed, limits.max_speed)),
            float(np.clip(turn_rate, -limits.max_turn_rate, limits.max_turn_rate)),
        )
        if self._follower is not None or self._remaining <= 0.0:
            self._start()
        self._follower = None
        self._remaining = self._config.command_timeout

    def stop(self) -> None:
        """Forget the path and stand."""
        self._follower, self._remaining = None, 0.0

    def _start(self) -> None:
        self._remaining, self._waited, self.problem = 0.0, 0.0, ""
        self._mark = self._first_tilt = None

    def update(self, odometry: FloatArray, truth: FloatArray, period: float) -> None:
        """Drive on for one control period.

        Args:
            odometry: x, y, yaw that the robot believes, shape (3,).
            truth: ``T_world_base``, shape (4, 4); what it is watched by.
            period: [s].
        """
        wanted = (0.0, 0.0)
        if self._follower is not None:
            wanted = self._follower.velocity(_seen_from(self._path_frame, odometry))
            if self._follower.done:
                self._follower = None
        elif self._remaining > 0.0:
            self._remaining -= period
            wanted = self._velocity
        self._watch(planar(truth), wanted, period)
        self._watch_tilt(float(np.arccos(np.clip(truth[2, 2], -1.0, 1.0))))
        if self.problem:
            wanted = (0.0, 0.0)
        self._drive.update(*wanted, period)

    def _watch(self, place: FloatArray, wanted: tuple[float, float], period: float) -> None:
        """Notice that it should move and does not."""
        if self._mark is None or wanted == (0.0, 0.0) or self._has_moved(place - self._mark):
            self._mark, self._waited = place, 0.0
            return
        self._waited += period
        if self._waited > self._config.stuck_time:
            self.problem = f"the base is stuck at x {place[0]:.2f}, y {place[1]:.2f}"
            self.stop()

    def _watch_tilt(self, tilt: float) -> None:
        """Stop before it tips over; what tilts too much already may drive out of it."""
        if self._first_tilt is None:
            self._first_tilt = tilt
        if self.active and tilt > max(self._config.max_tilt, self._first_tilt + _TILT_MARGIN):
            self.problem = f"the base tilts by {np.degrees(tilt):.0f} degrees"
            self.stop()
            self._drive.restart()  # brakes: a ramp would drive it on up what it leans on

    def _has_moved(self, change: FloatArray) -> bool:
        moved = float(np.linalg.norm(change[:2])) > self._config.stuck_distance
        return moved or abs(wrap(change[2])) > self._config.stuck_angle


def _seen_from(frame: FloatArray, pose: FloatArray) -> FloatArray:
    """A planar pose in the coordinates of a planar frame; x, y [m], yaw [rad] each, shape (3,)."""
    x, y, yaw = pose - frame
    cosine, sine = np.cos(frame[2]), np.sin(frame[2])
    return np.array([cosine * x + sine * y, cosine * y - sine * x, wrap(yaw)])
