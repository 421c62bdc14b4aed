"""Clocks that jump, as when a bag starts again: nothing on its way is lost, nothing is mixed.

A clock has jumped when several messages say so. A single wrong stamp is no jump.

Streams of one source do not jump at the same moment: a cloud is measured later than its pose. So
what was known before a jump is kept until the last stream has jumped too, and is used only for
data that are from before the jump.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from statistics import median
from typing import Generic, Protocol, TypeVar

from infomap_ros.geometry import Record

CLOCK_JUMP = 1_000_000_000
"""Images and odometry older than the newest by more than this have jumped back [ns]."""

LONE_STAMP = "lone stamp"
"""Why a datum is dropped whose stamp no other agrees with."""

_STEPS = 5  # last ones, whose median is the pace of a stream: two wrong ones do not change it

Kept_contra = TypeVar("Kept_contra", bound=Record, contravariant=True)
Kept = TypeVar("Kept", bound=Record)
Found_co = TypeVar("Found_co", covariant=True)
Found = TypeVar("Found")
Item = TypeVar("Item")


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


class ClockGate(Generic[Item]):
    """Lets data of one stream pass once their stamps are to be believed.

    A stamp that goes on from those before passes at once. One that steps, back by more than
    `CLOCK_JUMP` or ahead by more than the stream's own pace explains, is held until it is known
    whether the clock has jumped or the stamp alone is wrong. The next datum tells: it goes on
    from the step, or from before it. So may another stream (`agree`), or for a step ahead the
    time that has passed where the data are received. A lone stamp is dropped.

    Args:
        on_drop: called with the reason, in short and in a sentence, of each datum that is dropped.
        clock: time of the machine [s]; None where data come faster than they were taken.
    """

    def __init__(
        self,
        on_drop: Callable[[str, str], None] = lambda *_: None,
        clock: Callable[[], float] | None = None,
    ) -> None:
        self._on_drop, self._clock = on_drop, clock
        self._newest: int | None = None
        self._steps: deque[int] = deque(maxlen=_STEPS)
        self._held: list[tuple[int, Item]] = []
        self._passed_at = 0.0

    def add(self, stamp: int, item: Item) -> list[tuple[Item, bool]]:
        """Add a datum with its stamp [ns].

        Returns:
            What may pass now, in its order, each with whether the clock has jumped back to it.
        """
        if self._newest is None or self._goes_on(self._newest, stamp) or self._took_so_long(stamp):
            self._drop_held()
            return [self._pass(stamp, item)]
        if self._held and self._goes_on(self._held[-1][0], stamp):
            self._drop_held(but=1)
            return [*self._release(), self._pass(stamp, item)]
        if self._held and self._is_pace(stamp):
            return [*self._release(), self._pass(stamp, item)]
        may_show_pace = self._held and self._held[-1][0] < stamp
        self._drop_held(but=1 if may_show_pace else 0)
        self._held.append((stamp, item))
        return []

    def agree(self, stamp: int) -> list[tuple[Item, bool]]:
        """Another stream has come to a stamp [ns]; returns as `add`."""
        near = self._held and abs(stamp - self._held[-1][0]) <= self._most_ahead()
        return self._release() if near else []

    def finish(self) -> list[tuple[Item, bool]]:
        """At the end of the data, what was only ahead may pass; returns as `add`."""
        if self._held and self._held[0][0] < (self._newest or 0):
            self._drop_held()
        return self._release()

    def _release(self) -> list[tuple[Item, bool]]:
        """What was held is believed."""
        held, self._held = self._held, []
        return [self._pass(*each) for each in held]

    def _pass(self, stamp: int, item: Item) -> tuple[Item, bool]:
        newest = self._newest if self._newest is not None else stamp
        has_jumped = stamp < newest - self._most_behind()
        if stamp > newest:
            self._steps.append(stamp - newest)
        self._newest = stamp if has_jumped else max(newest, stamp)
        self._passed_at = 0.0 if self._clock is None else self._clock()
        return item, has_jumped

    def _goes_on(self, before: int, stamp: int) -> bool:
        return -self._most_behind() <= stamp - before <= self._most_ahead()

    def _is_pace(self, stamp: int) -> bool:
        """Whether a stamp and what is held are steps of a stream that is slow."""
        *earlier, last = (self._newest or 0, *(each for each, _ in self._held))
        ahead, before = stamp - last, last - earlier[-1]
        return 0 < 2 * ahead <= 3 * before <= 6 * ahead

    def _most_ahead(self) -> int:
        """How far the next stamp may be ahead [ns]."""
        return max(CLOCK_JUMP, 3 * self._pace() // 2)

    def _most_behind(self) -> int:
        """How far it may be behind [ns]: as far as a wrong one that passed may have been ahead."""
        return max(CLOCK_JUMP, 3 * self._pace() // 5)

    def _pace(self) -> int:
        return int(median(self._steps)) if len(self._steps) > 1 else 0

    def _took_so_long(self, stamp: int) -> bool:
        """Whether a step ahead is as long as the time since the last datum passed."""
        if self._clock is None or self._newest is None:
            return False
        passed = round(1e9 * (self._clock() - self._passed_at))
        return abs(stamp - self._newest - passed) <= CLOCK_JUMP and stamp > self._newest

    def _drop_held(self, but: int = 0) -> None:
        """Nothing agrees with what is held, but for the last ones."""
        while len(self._held) > but:
            stamp = self._held.pop(0)[0]
            off = (stamp - (self._newest or 0)) / 1e9
            self._on_drop(LONE_STAMP, f"stamp {stamp} ns is {off:+.3f} s off and no other agrees")
