"""Clocks that jump back, as when a bag starts again: nothing on its way is lost, nothing is mixed.

Streams of one source do not jump at the same moment: a cloud is measured later than its pose. So
what was known before a jump is kept until the last stream has jumped too, and is used only for
data that are from before the jump.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Generic, Protocol, TypeVar

from infomap_ros.geometry import ImageRecord, Record
from infomap_ros.geometry.pairing import StampPairing

CLOCK_JUMP = 1_000_000_000
"""Images and odometry older than the newest by more than this have jumped back [ns]."""

Kept_contra = TypeVar("Kept_contra", bound=Record, contravariant=True)
Kept = TypeVar("Kept", bound=Record)
Found_co = TypeVar("Found_co", covariant=True)
Found = TypeVar("Found")


class Buffer(Protocol[Kept_contra, Found_co]):
    """What `PoseBuffer` and `JointBuffer` have in common."""

    def add(self, record: Kept_contra, /) -> object:
        """Keep a record."""

    def at(self, stamp: int, /) -> Found_co:
        """What is known at a time [ns]."""


class JumpingBuffer(Generic[Kept, Found]):
    """A buffer that keeps what was known before the last jump, for data from before it.

    Args:
        make: makes an empty buffer.
        jump: a record older than the newest by more than this has jumped back [ns].
    """

    def __init__(self, make: Callable[[], Buffer[Kept, Found]], jump: int) -> None:
        self._make, self._jump = make, jump
        self._now = make()
        self._before: Buffer[Kept, Found] | None = None
        self._newest: int | None = None

    def add(self, record: Kept) -> None:
        """Keep a record; raises as the buffer's `add` does."""
        if self._newest is not None and record.stamp < self._newest - self._jump:
            self._before, self._now = self._now, self._make()
            self._newest = record.stamp
        self._now.add(record)
        self._newest = max(record.stamp, self._newest or 0)

    def at(self, stamp: int) -> Found:
        """What is known at a time [ns]; raises as the buffer's `at` does."""
        newest = self._newest or 0
        if self._before is not None and stamp > newest + self._jump:
            return self._before.at(stamp)
        return self._now.at(stamp)

    def others_have_jumped(self, stamp: int) -> None:
        """Those who ask have jumped back to `stamp` [ns]: forget what was before."""
        has_jumped, self._before = self._before is not None, None
        if not has_jumped and self._newest is not None and self._newest > stamp + self._jump:
            self._now = self._make()
            self._newest = None


class JumpingPairs:
    """Pairs images of two streams by stamp, each only with one from the same side of a jump.

    What still waits for its partner when both streams have jumped is dropped.

    Args:
        tolerance: largest difference of the stamps of a pair [ns].
        jump: an image older than the newest of its stream by more than this has jumped back [ns].
        on_drop: told why, for each image that is dropped.
    """

    def __init__(self, tolerance: int, jump: int, on_drop: Callable[[str], None]) -> None:
        self._tolerance, self._jump, self._on_drop = tolerance, jump, on_drop
        self._newest = [0, 0]
        self._rounds = [0, 0]
        self._pairings: dict[int, StampPairing[ImageRecord, ImageRecord]] = {}

    def add(self, side: int, image: ImageRecord) -> tuple[ImageRecord, ImageRecord] | None:
        """Add an image of the first (0) or second (1) stream; returns the pair it completes."""
        if image.stamp < self._newest[side] - self._jump:
            self._newest[side] = image.stamp
            self._rounds[side] += 1
            self._drop_finished_rounds()
        self._newest[side] = max(self._newest[side], image.stamp)
        pairing = self._pairings.setdefault(self._rounds[side], StampPairing(self._tolerance))
        before = pairing.unpaired
        pair = pairing.add_second(image) if side else pairing.add_first(image)
        for _ in range(pairing.unpaired - before):
            self._on_drop("no partner")
        return pair

    def drop_all(self, reason: str) -> None:
        """Drop every image that still waits for its partner, for one reason."""
        self._drop(list(self._pairings), reason)

    def _drop_finished_rounds(self) -> None:
        finished = [number for number in self._pairings if number < min(self._rounds)]
        self._drop(finished, "time went backwards")

    def _drop(self, rounds: list[int], reason: str) -> None:
        for number in rounds:
            for _ in range(self._pairings.pop(number).clear()):
                self._on_drop(reason)
