"""Data that wait for the pose at their stamp."""

from __future__ import annotations

from bisect import insort
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from typing import Generic, TypeVar

from infomap_ros.errors import PoseUnavailableError
from infomap_ros.geometry.config import check_config, setting
from infomap_ros.geometry.records import PoseRecord

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
