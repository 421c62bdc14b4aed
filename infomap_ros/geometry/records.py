"""Data with its stamp and frame: what a live topic and a bag both become.

Stamps are integer nanoseconds since the epoch of the source's clock. A record is immutable; its
arrays must not be written to.

Data that wait for the pose at their stamp.
"""

from __future__ import annotations

from bisect import insort
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from infomap_ros.errors import PoseUnavailableError
from infomap_ros.geometry.camera import CameraCalibration
from infomap_ros.geometry.config import check_config, setting
from infomap_ros.geometry.pose_uncertainty import PoseUncertainty
from infomap_ros.geometry.transforms import FloatArray


@dataclass(frozen=True, eq=False)
class Record:
    """Common part of all records.

    Attributes:
        stamp: time of measurement [ns].
        frame_id: frame in which the data are expressed.
    """

    stamp: int
    frame_id: str


@dataclass(frozen=True, eq=False)
class ImageRecord(Record):
    """An image.

    Attributes:
        pixels: shape (H, W) or (H, W, channels); dtype as the encoding says.
        encoding: as in ``sensor_msgs/image_encodings``, for example ``mono8``, ``rgb8``,
            ``32FC1`` (depth in m), ``16UC1`` (depth in mm).
    """

    pixels: NDArray[np.generic]
    encoding: str


@dataclass(frozen=True, eq=False)
class CameraInfoRecord(Record):
    """A camera's calibration."""

    calibration: CameraCalibration


@dataclass(frozen=True, eq=False)
class PoseRecord(Record):
    """Pose of a child frame in `frame_id`.

    Attributes:
        transform: ``T_frame_child``, shape (4, 4).
        covariance: shape (6, 6), order and convention of `geometry.transforms`; None if unknown
            (never zero for unknown).
        child_frame_id: empty where the message does not say.
        uncertainty: the covariance in its parts, None where nobody says.
    """

    transform: FloatArray
    covariance: FloatArray | None = None
    child_frame_id: str = ""
    uncertainty: PoseUncertainty | None = field(default=None, kw_only=True)


@dataclass(frozen=True, eq=False)
class OdometryRecord(PoseRecord):
    """Odometry: a pose and the velocity of the child frame.

    Attributes:
        twist: linear [m/s] and angular [rad/s] velocity in the child frame, shape (6,).
        twist_covariance: shape (6, 6) or None if unknown.
    """

    twist: FloatArray | None = None
    twist_covariance: FloatArray | None = None


@dataclass(frozen=True, eq=False)
class JointStateRecord(Record):
    """Joint positions.

    Attributes:
        names: n joint names.
        positions: shape (n,) [rad or m].
        velocities: shape (n,) [rad/s or m/s], or None where the message has none.
    """

    names: tuple[str, ...]
    positions: FloatArray
    velocities: FloatArray | None = None


@dataclass(frozen=True, eq=False)
class ImuRecord(Record):
    """A sample of an inertial sensor.

    Attributes:
        angular_velocity: shape (3,) [rad/s].
        acceleration: what it feels, against gravity at rest, shape (3,) [m/s^2]; None if unknown.
    """

    angular_velocity: FloatArray
    acceleration: FloatArray | None = None


@dataclass(frozen=True, eq=False)
class TransformRecord(Record):
    """One edge of the tf tree: ``T_frame_child``.

    Attributes:
        child_frame_id: the child.
        transform: shape (4, 4).
        is_static: from /tf_static.
    """

    child_frame_id: str
    transform: FloatArray
    is_static: bool = False


@dataclass(frozen=True, eq=False)
class PointCloudRecord(Record):
    """Range points.

    Attributes:
        points: shape (H, W, 3) when organized, else (N, 3), float32 [m]; NaN = no measurement.
        covariances: shape (..., 3, 3) like points, or (..., 6) as (xx, xy, xz, yy, yz, zz), float32
            [m^2]; None if unknown.
        colors: shape (..., 3), uint8 RGB, or None.
        error_correlation: mean correlation of the errors of two points of one surface patch, 0 to
            1; None if unknown.
    """

    points: NDArray[np.float32]
    covariances: NDArray[np.float32] | None = None
    colors: NDArray[np.uint8] | None = None
    error_correlation: float | None = None


@dataclass(frozen=True, eq=False)
class TextRecord(Record):
    """A string, for example a robot description."""

    text: str


Item = TypeVar("Item")

_NANOSECONDS = 1_000_000_000


@dataclass(frozen=True)
class WaitingQueueConfig:
    """Configuration of `WaitingQueue`."""

    capacity: int = setting(
        10, "Number of items that wait at most; the oldest is dropped for a new one.", low=1
    )
    max_wait: float = setting(
        1.0, "How long an item waits for its pose, in time of the data.", unit="s", low=0.0
    )

    def __post_init__(self) -> None:
        check_config(self)


class WaitingQueue(Generic[Item]):
    """Holds stamped items until the pose at their stamp is known.

    Nothing blocks: an item that will never get a pose is dropped with a reason, and the others go
    on. Reasons are those of `PoseUnavailableError`, or ``queue full``, or
    ``time went backwards``: an item more than `max_wait` older than the newest one says that the
    clock was set back, so those that wait are dropped.

    Attributes:
        dropped: number of dropped items by reason.
    """

    def __init__(
        self,
        pose_at: Callable[[int], PoseRecord],
        config: WaitingQueueConfig | None = None,
        on_drop: Callable[[Item, str, str], None] | None = None,
    ) -> None:
        """Create an empty queue.

        Args:
            pose_at: gives the pose at a stamp [ns] or raises `PoseUnavailableError`, as
                `PoseBuffer.at` does.
            config: limits.
            on_drop: called with each dropped item, the reason, and the reason in a sentence.
        """
        self.config = config or WaitingQueueConfig()
        self.dropped: Counter[str] = Counter()
        self._pose_at = pose_at
        self._on_drop = on_drop
        self._max_wait = round(self.config.max_wait * _NANOSECONDS)
        self._waiting: list[_Waiting[Item]] = []
        self._newest: int | None = None
        self._pushed, self._why = 0, ""

    def __len__(self) -> int:
        return len(self._waiting)

    def push(self, stamp: int, item: Item) -> None:
        """Add an item; stamp [ns]."""
        if self._newest is not None and stamp < self._newest - self._max_wait:
            self.drop_all("time went backwards")
            self._newest = None
        self._newest = stamp if self._newest is None else max(self._newest, stamp)
        if len(self._waiting) >= self.config.capacity:
            oldest = self._waiting.pop(0)
            waits = f"{self.config.capacity} items wait for poses"
            self._drop(oldest, "queue full", f"{waits}: {self._why}" if self._why else waits)
        self._pushed += 1
        insort(self._waiting, _Waiting(stamp, self._pushed, item))

    def take(self, now: int | None = None) -> list[tuple[Item, PoseRecord]]:
        """Take the items whose pose is known, in order of time; drop those that waited too long.

        Args:
            now: time of the data [ns]; the newest stamp that was pushed where not given.
        """
        now = self._newest if now is None else now
        ready, waiting = [], []
        for entry in self._waiting:
            try:
                ready.append((entry.item, self._pose_at(entry.stamp)))
            except PoseUnavailableError as error:
                self._why = str(error)
                in_time = now is not None and now - entry.stamp <= self._max_wait
                if error.may_arrive and in_time:
                    waiting.append(entry)
                else:
                    self._drop(entry, error.reason, str(error))
        self._waiting = waiting
        return ready

    def drop_all(self, reason: str) -> None:
        """Drop every item that waits, for one reason."""
        waiting, self._waiting = self._waiting, []
        for entry in waiting:
            self._drop(entry, reason, reason)

    def _drop(self, entry: _Waiting[Item], reason: str, sentence: str) -> None:
        self.dropped[reason] += 1
        if self._on_drop is not None:
            self._on_drop(entry.item, reason, sentence)


@dataclass(frozen=True)
class _Waiting(Generic[Item]):
    stamp: int
    number: int
    item: Item

    def __lt__(self, other: _Waiting[Item]) -> bool:
        return (self.stamp, self.number) < (other.stamp, other.number)
