"""Follows a path of base poses: turns on the spot where it must, and drives along the rest.

Pure pursuit after R. C. Coulter, Implementation of the Pure Pursuit Path Tracking Algorithm,
CMU-RI-TR-92-01 (1992): steer along the circle through the point of the path that is one look-ahead
distance away. `PathDriving` limits accelerations and notices a base that is stuck; how long a drive
takes is found with the same control.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise
from typing import ClassVar

import numpy as np

from infomap_ros.errors import InvalidInputError
from infomap_ros.geometry.config import check_config, setting
from infomap_ros.geometry.transforms import FloatArray

_SAME_PLACE = 1e-3  # [m]


@dataclass(frozen=True)
class PathFollowingConfig:
    """Parameters of the drive."""

    max_speed: float = setting(0.25, "Largest speed.", unit="m/s", low=0.01, high=3.0)
    max_turn_rate: float = setting(0.6, "Largest turn rate.", unit="rad/s", low=0.05, high=5.0)
    acceleration: float = setting(0.4, "Largest acceleration.", unit="m/s^2", low=0.01, high=10.0)
    turn_acceleration: float = setting(
        1.5, "Largest acceleration of the turn rate.", unit="rad/s^2", low=0.05, high=50.0
    )
    look_ahead: float = setting(
        0.15, "Distance of the point that is steered to.", unit="m", low=0.02, high=3.0
    )
    position_tolerance: float = setting(
        0.02, "Distance at which a point of the path is reached.", unit="m", low=0.002, high=1.0
    )
    angle_tolerance: float = setting(
        0.02, "Angle at which a heading is reached.", unit="rad", low=0.002, high=1.0
    )
    turn_first: ClassVar[float] = 0.5
    """Heading error above which it turns on the spot [rad]."""

    def __post_init__(self) -> None:
        """Validate all fields."""
        check_config(self)


@dataclass(frozen=True, eq=False)
class _Leg:
    """A part of the path that is driven in one direction, or a turn on the spot.

    Attributes:
        points: shape (n, 2) [m]; one point for a turn.
        forward: +1 or -1.
        heading: to be reached at the end [rad]; NaN where the next leg does not care.
    """

    points: FloatArray
    forward: float
    heading: float


class PathFollower:
    """One path, followed by asking for the velocity at each present pose.

    Args:
        poses: x, y [m], yaw [rad], shape (K, 3), in any fixed frame.
        config: the parameters.

    Raises:
        InvalidInputError: wrong shape, no pose, or not finite.
    """

    def __init__(self, poses: FloatArray, config: PathFollowingConfig) -> None:
        path = np.array(poses, dtype=np.float64)
        if path.ndim != 2 or path.shape[1] != 3 or not len(path):
            raise InvalidInputError("base path", f"shape {path.shape}, expected (K, 3)")
        if not np.isfinite(path).all():
            raise InvalidInputError("base path", "holds NaN or infinity")
        self._config = config
        self._legs = _split(path)
        self._turning = False

    @property
    def done(self) -> bool:
        """Whether the end has been reached."""
        return not self._legs

    def velocity(self, pose: FloatArray) -> tuple[float, float]:
        """Wanted forward speed [m/s] and turn rate [rad/s] at x, y [m], yaw [rad], shape (3,)."""
        while self._legs:
            leg = self._legs[0]
            wanted = self._drive(leg, pose) if len(leg.points) > 1 else self._turn(leg, pose)
            if wanted is not None:
                return wanted
            self._legs.pop(0)
            self._turning = False
        return 0.0, 0.0

    def _turn(self, leg: _Leg, pose: FloatArray) -> tuple[float, float] | None:
        error = wrap(leg.heading - pose[2])
        if abs(error) < self._config.angle_tolerance:
            return None
        return 0.0, self._turn_rate(error)

    def _turn_rate(self, error: float) -> float:
        """Turn rate that can still stop at an error [rad] of zero."""
        slowing = np.sqrt(self._config.turn_acceleration * abs(error))
        rate = min(self._config.max_turn_rate, float(slowing), 3.0 * abs(error) + 0.02)
        return float(np.copysign(rate, error))

    def _drive(self, leg: _Leg, pose: FloatArray) -> tuple[float, float] | None:
        points, config = leg.points, self._config
        along, target = _aim(points, pose[:2], config.look_ahead)
        direction = points[-1] - points[-2]
        beyond = (pose[:2] - points[-1]) @ direction / np.linalg.norm(direction)
        left = along + float(np.linalg.norm(points[-1] - pose[:2])) if along else -beyond
        if left < config.position_tolerance and along == 0.0:
            return None
        bearing = np.arctan2(*(target - pose[:2])[::-1])
        error = wrap(bearing - pose[2] - (0.0 if leg.forward > 0 else np.pi))
        limit = config.turn_first if not self._turning else 3.0 * config.angle_tolerance
        self._turning = abs(error) > limit
        if self._turning:
            return 0.0, self._turn_rate(error)
        speed = min(config.max_speed, float(np.sqrt(config.acceleration * max(left, 0.0))) + 0.01)
        speed *= max(0.2, float(np.cos(error)) ** 3)
        distance = max(float(np.linalg.norm(target - pose[:2])), 0.5 * config.look_ahead)
        rate = 2.0 * speed * np.sin(error) / distance
        return leg.forward * speed, float(
            np.clip(rate, -config.max_turn_rate, config.max_turn_rate)
        )


def split_path(poses: FloatArray) -> list[FloatArray]:
    """Cut a path into pieces for followers that do not turn on the spot within one.

    Each piece is driven forward or backward alone; its last pose has the heading to which it turns
    where it ends. Two poses at one place are a turn alone.

    Args:
        poses: x, y [m], yaw [rad], shape (K, 3).
    """
    pieces: list[list[FloatArray]] = [[poses[0]]]
    last = 0.0
    for begin, end in pairwise(poses):
        step = end[:2] - begin[:2]
        if np.linalg.norm(step) <= _SAME_PLACE:
            if len(pieces[-1]) > 1:
                pieces[-1][-1] = end  # the heading at its end
            else:
                pieces[-1].append(end)
            last = 0.0
            continue
        heading = begin[2] + 0.5 * wrap(end[2] - begin[2])
        sign = 1.0 if step @ np.array([np.cos(heading), np.sin(heading)]) >= 0.0 else -1.0
        if sign != last and len(pieces[-1]) > 1:
            pieces.append([pieces[-1][-1]])
        pieces[-1].append(end)
        last = sign
    return [np.array(piece) for piece in pieces]


def wrap(angle: float) -> float:
    """The same angle between -pi and pi [rad]."""
    return float(np.arctan2(np.sin(angle), np.cos(angle)))


def _split(path: FloatArray) -> list[_Leg]:
    """Cut a path where it turns on the spot or changes between forward and backward."""
    steps = np.diff(path[:, :2], axis=0)
    moves = np.linalg.norm(steps, axis=1) > _SAME_PLACE
    legs: list[_Leg] = [_Leg(path[:1, :2], 1.0, float("nan"))]
    headings = path[:-1, 2] + 0.5 * np.arctan2(
        np.sin(np.diff(path[:, 2])), np.cos(np.diff(path[:, 2]))
    )
    ahead = np.einsum("ij,ij->i", steps, np.column_stack([np.cos(headings), np.sin(headings)]))
    for index, moving in enumerate(moves):
        end = path[index + 1]
        if not moving:
            legs.append(_Leg(end[None, :2], 1.0, float(end[2])))
            continue
        forward = 1.0 if ahead[index] >= 0.0 else -1.0
        last = legs[-1]
        if len(last.points) > 1 and last.forward == forward:
            legs[-1] = _Leg(np.vstack([last.points, end[:2]]), forward, last.heading)
        else:
            legs.append(_Leg(np.stack([path[index, :2], end[:2]]), forward, float("nan")))
    legs = [leg for leg in legs if len(leg.points) > 1 or np.isfinite(leg.heading)]
    return [*legs, _Leg(path[-1:, :2], 1.0, float(path[-1, 2]))]


def _aim(points: FloatArray, place: FloatArray, look_ahead: float) -> tuple[float, FloatArray]:
    """Distance left beyond the look-ahead point [m], 0 at the end, and that point.

    Beyond the end it is on the last part's straight continuation: who aims at an end nearby turns
    to and fro for every centimeter that a slip has put it beside.
    """
    starts, steps = points[:-1], np.diff(points, axis=0)
    lengths = np.linalg.norm(steps, axis=1)
    share = np.einsum("ij,ij->i", place - starts, steps) / lengths**2
    feet = starts + np.clip(share, 0.0, 1.0)[:, None] * steps
    nearest = int(np.argmin(np.linalg.norm(feet - place, axis=1)))
    ends = np.cumsum(lengths)
    position = ends[nearest] - lengths[nearest] * (1.0 - np.clip(share[nearest], 0.0, 1.0))
    wanted = position + look_ahead
    if wanted >= ends[-1]:
        return 0.0, points[-1] + (wanted - ends[-1]) / lengths[-1] * steps[-1]
    segment = int(np.searchsorted(ends, wanted))
    back = (ends[segment] - wanted) / lengths[segment]
    return float(ends[-1] - wanted), points[segment + 1] - back * steps[segment]


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
        distance, turn = float(np.linalg.norm(change[:2])), abs(wrap(float(change[2])))
        return distance > _PROGRESS[0] or turn > _PROGRESS[1]


def _towards(value: float, wanted: float, change: float) -> float:
    return value + float(np.clip(wanted - value, -change, change))


_PERIOD = 0.05  # [s] of the control; half of it changes the time by less than one percent
_LAG = 0.5  # [s] of wheels behind what they are told, and until odometry shows that they rest
_SLOWEST = 0.02  # share of the largest speeds below which nothing is driven for long


def drive_seconds(path: FloatArray, config: PathFollowingConfig) -> float:
    """Time from rest to rest of a base that follows a path as told, but for a lag [s].

    Args:
        path: x, y [m] and yaw [rad], shape (K, 3); without length it takes no time.
        config: speeds and accelerations.
    """
    if len(path) < 2:
        return 0.0
    driving, pose, seconds = PathDriving(config), np.array(path[0]), 0.0
    driving.follow(path)
    length = float(np.hypot(*np.diff(path[:, :2], axis=0).T).sum())
    turning = float(np.abs(np.diff(path[:, 2])).sum())
    longest = 10.0 + (length / config.max_speed + turning / config.max_turn_rate) / _SLOWEST
    while seconds < longest:
        speed, turn_rate = driving.velocity(pose, _PERIOD)
        if driving.done or driving.problem:
            break
        middle = pose[2] + 0.5 * turn_rate * _PERIOD
        pose[0] += speed * _PERIOD * math.cos(middle)
        pose[1] += speed * _PERIOD * math.sin(middle)
        pose[2] += turn_rate * _PERIOD
        seconds += _PERIOD
    return seconds + _LAG
