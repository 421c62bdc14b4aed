"""Images wait here until it is known how the robot stood when they were taken."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Generic, Protocol, TypeVar

import numpy as np

from infomap_ros.geometry import PlacedSolid, PoseRecord
from infomap_ros.geometry.records import WaitingQueue, WaitingQueueConfig
from infomap_ros.localization.filter.motion_prior import RobotPosture
from infomap_ros.pipeline.clock_jumps import CLOCK_JUMP
from infomap_ros.pipeline.inertial import InertialReading, InertialSensor
from infomap_ros.pipeline.scan_synchronizer import CLOCK_JUMPED


class Images(Protocol):
    """What was taken at one moment: images, or the view that was made of them."""

    @property
    def stamp(self) -> int:
        """Of the first image [ns]."""

    @property
    def frame_id(self) -> str:
        """Optical frame of the first image."""


Item = TypeVar("Item", bound=Images)


class MotionSource(Protocol):
    """Knows how the robot stood, by odometry and joints."""

    @property
    def is_offered(self) -> bool:
        """Whether there is odometry, so that it is worth waiting for."""

    @property
    def odom_frame(self) -> str:
        """Frame of odometry, empty before any has come."""

    def posture(self, stamp: int) -> RobotPosture:
        """Where base and camera were at a time [ns]; raises `PoseUnavailableError`."""

    def body(self, stamp: int) -> list[PlacedSolid]:
        """The robot's solids in the camera's frame; none where they are not known."""


@dataclass(frozen=True, eq=False)
class PosturedView(Generic[Item]):
    """The images of one moment, with what the robot knows of itself.

    Attributes:
        images: as they were added.
        posture: where base and camera were by odometry and joints, None where that is not known.
        body: solids of the robot in the camera's frame.
        odom_frame: frame of odometry, empty where there is none.
        inertial: what an inertial sensor tells, None where there is none, or odometry.
    """

    images: Item
    posture: RobotPosture | None = None
    body: Sequence[PlacedSolid] = ()
    odom_frame: str = ""
    inertial: InertialReading | None = None

    @property
    def stamp(self) -> int:
        """Of the first image [ns]."""
        return self.images.stamp


class ViewSynchronizer(Generic[Item]):
    """Gives out views in the order of time, each when the robot's posture is known.

    Where it is not known in time they go on without it; but where odometry is wanted, not before
    the first one that has it, with which the map begins.

    Args:
        motion: of the robot; None where it is not used.
        inertial: sensor on the camera, which tells how it turns where there is no odometry.
        is_required: whether views have to wait although no odometry is offered yet.
        waiting: how long views wait.
        on_drop: called with the reason, in short and in a sentence, of each view that is dropped.
        on_unknown_motion: called with the reason for each view that goes on without its posture.
    """

    def __init__(
        self,
        motion: MotionSource | None,
        inertial: InertialSensor | None = None,
        *,
        is_required: bool = False,
        waiting: WaitingQueueConfig | None = None,
        on_drop: Callable[[str, str], None] = lambda *_: None,
        on_unknown_motion: Callable[[str], None] = lambda _: None,
    ) -> None:
        self._motion, self._inertial, self._is_required = motion, inertial, is_required
        self._on_drop, self._on_unknown_motion = on_drop, on_unknown_motion
        self._newest, self._has_begun = 0, False
        self._without: list[Item] = []
        self._waiting: WaitingQueue[Item] = WaitingQueue(self._pose_at, waiting, self._on_no_pose)

    def add(self, images: Item) -> bool:
        """Add the images of one moment; returns whether their clock has jumped back."""
        has_jumped = images.stamp < self._newest - CLOCK_JUMP
        if has_jumped:
            self._waiting.drop_all(CLOCK_JUMPED)
            self._newest, self._has_begun = 0, False
        self._newest = max(self._newest, images.stamp)
        self._waiting.push(images.stamp, images)
        return has_jumped

    def take(self, now: int | None = None) -> list[PosturedView[Item]]:
        """The views that can go on by now.

        Args:
            now: time of the data [ns]; that of the newest images where not given.
        """
        views = [self._complete(images) for images, _ in self._waiting.take(now)]
        views += [PosturedView(images) for images in self._without]
        self._without = []
        self._has_begun = self._has_begun or bool(views)
        return sorted(views, key=lambda each: each.stamp)

    @property
    def _used_motion(self) -> MotionSource | None:
        if self._motion is None or not (self._is_required or self._motion.is_offered):
            return None
        return self._motion

    def _pose_at(self, stamp: int) -> PoseRecord:
        """Whether the robot's posture is known, or nobody tells it; see `WaitingQueue`."""
        motion = self._used_motion
        if motion is not None:
            return PoseRecord(stamp, "", motion.posture(stamp).T_odom_camera)
        if self._inertial is not None:
            self._inertial.knows(stamp)
        return PoseRecord(stamp, "", np.eye(4))

    def _on_no_pose(self, images: Item, reason: str, sentence: str) -> None:
        if reason == CLOCK_JUMPED or (self._used_motion is not None and not self._has_begun):
            self._on_drop(reason, sentence)
        else:
            self._on_unknown_motion(reason)
            self._without.append(images)

    def _complete(self, images: Item) -> PosturedView[Item]:
        """Images with the robot's posture and body."""
        motion, stamp = self._used_motion, images.stamp
        if motion is None:
            reading = None if self._inertial is None else self._inertial.at(stamp)
            return PosturedView(images, inertial=reading)
        return PosturedView(images, motion.posture(stamp), motion.body(stamp), motion.odom_frame)
