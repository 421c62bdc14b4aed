"""How an inertial sensor that is fixed to the camera says that it turns, and what is up."""

from __future__ import annotations

from bisect import bisect_right
from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from infomap_ros.errors import FrameError, PoseUnavailableError
from infomap_ros.geometry import Record, TransformRecord
from infomap_ros.geometry.pose_buffer import TransformTree
from infomap_ros.geometry.records import ImuRecord
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.localization.filter.lie import exponential
from infomap_ros.pipeline.clock_jumps import CLOCK_JUMP

_LONGEST_GAP = 100_000_000  # [ns] between two samples across which a turn is known
_SILENT = 500_000_000  # [ns] after which a sensor that tells nothing is not waited for
_KEPT = 20_000  # samples: 20 s at 1 kHz
_FASTEST = 100.0  # [rad/s]; gyroscopes end at a third of it, so more is no measurement
_LEVELLING = 1_000_000_000  # [ns] over which accelerations are averaged
_GRAVITY = (5.0, 15.0)  # [m/s^2] between which an acceleration is taken for mostly gravity


@dataclass(frozen=True, eq=False)
class InertialReading:
    """What an inertial sensor knew when a view was taken.

    Attributes:
        rotation: of the camera since integration began, ``R_begin_camera``, shape (3, 3).
        begun: when that was [ns].
        up: unit vector against gravity in the camera's frame, shape (3,); None where unknown.
    """

    rotation: FloatArray
    begun: int
    up: FloatArray | None

    def turn_since(self, before: InertialReading | None) -> FloatArray | None:
        """``R_before_now``, shape (3, 3); None where samples are missing in between."""
        if before is None or before.begun != self.begun:
            return None
        return np.asarray(before.rotation.T @ self.rotation)


class InertialSensor:
    """Integrates angular velocities, and averages accelerations in a frame that does not turn.

    Where the sensor is on the camera is told by fixed edges of tf; until they are known, and while
    nothing is heard of the sensor, it is as if there were none.

    Args:
        camera_frame: optical frame of the camera; see `look_from`.
        static: fixed edges of tf.
    """

    def __init__(self, camera_frame: str = "", static: Iterable[TransformRecord] = ()) -> None:
        self._camera_frame, self._frame = camera_frame, ""
        self._tree = TransformTree()
        for edge in static:
            self._tree.add_transform(edge)
        self._forget()

    def _forget(self) -> None:
        self._stamps: list[int] = []
        self._rotations: list[FloatArray] = []  # R_begin_sensor at each stamp
        self._rates: list[FloatArray] = []
        self._begun = 0
        self._accelerations: deque[tuple[int, FloatArray]] = deque()  # in the frame of the begin

    def look_from(self, camera_frame: str) -> None:
        """Set in which frame images are."""
        self._camera_frame = camera_frame

    def is_mounted(self, frame: str) -> bool:
        """Whether fixed edges tell how a sensor with this frame is turned to the camera."""
        return self._mounting(frame) is not None

    def add(self, record: Record) -> None:
        """Take a sample or a fixed edge of tf; other records are ignored."""
        if isinstance(record, TransformRecord) and record.is_static:
            self._tree.add_transform(record)
        elif isinstance(record, ImuRecord):
            self._take(record)

    def _take(self, sample: ImuRecord) -> None:
        newest = self._stamps[-1] if self._stamps else -(2**62)
        if sample.frame_id == self._frame and newest - CLOCK_JUMP < sample.stamp <= newest:
            return
        if not np.abs(sample.angular_velocity).max() < _FASTEST:
            return
        if sample.frame_id != self._frame or not 0 < sample.stamp - newest <= _LONGEST_GAP:
            self._forget()
            self._frame, self._begun = sample.frame_id, sample.stamp
            rotation = np.eye(3)
        else:
            mean = 0.5 * (self._rates[-1] + sample.angular_velocity)
            rotation = self._rotations[-1] @ exponential(1e-9 * (sample.stamp - newest) * mean)
        self._stamps.append(sample.stamp)
        self._rotations.append(rotation)
        self._rates.append(sample.angular_velocity)
        if len(self._stamps) > 2 * _KEPT:
            for kept in (self._stamps, self._rotations, self._rates):
                del kept[:_KEPT]
        force = sample.acceleration
        if force is not None and _GRAVITY[0] < np.linalg.norm(force) < _GRAVITY[1]:
            self._accelerations.append((sample.stamp, rotation @ force))
            while self._accelerations[0][0] < sample.stamp - _LEVELLING:
                self._accelerations.popleft()

    def knows(self, stamp: int) -> bool:
        """Whether the sensor says how the camera was turned at a time [ns].

        Raises:
            PoseUnavailableError: the next sample, which is to come, will say.
        """
        if not self._stamps or not self._stamps[0] <= stamp <= self._stamps[-1] + _SILENT:
            return False
        if not self.is_mounted(self._frame):
            return False
        late = stamp - self._stamps[-1]
        if late > 0:
            text = f"stamp {stamp} ns is {1e-9 * late:.3f} s after the last inertial sample"
            raise PoseUnavailableError(text, "after the last inertial sample", may_arrive=True)
        return True

    def at(self, stamp: int) -> InertialReading | None:
        """What is known at a time [ns]; None where that is nothing. Raises as `knows`."""
        R_sensor_camera = self._mounting(self._frame) if self.knows(stamp) else None
        if R_sensor_camera is None:
            return None
        place = bisect_right(self._stamps, stamp) - 1
        following = min(place + 1, len(self._stamps) - 1)
        rate = 0.5 * (self._rates[place] + self._rates[following])
        since = 1e-9 * (stamp - self._stamps[place])
        rotation = self._rotations[place] @ exponential(since * rate) @ R_sensor_camera
        return InertialReading(rotation, self._begun, self._up(rotation))

    def _mounting(self, frame: str) -> FloatArray | None:
        """How the camera is turned on the sensor, shape (3, 3); None where tf does not tell."""
        try:
            return self._tree.between(frame, self._camera_frame, 0)[:3, :3]
        except (FrameError, PoseUnavailableError):
            return None

    def _up(self, R_begin_camera: FloatArray) -> FloatArray | None:
        if not self._accelerations:
            return None
        mean = np.mean([force for _, force in self._accelerations], axis=0)
        length = float(np.linalg.norm(mean))
        return R_begin_camera.T @ mean / length if length > _GRAVITY[0] else None
