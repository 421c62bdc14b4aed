"""When to publish which message of a bag. Knows no ROS and reads no clock: the caller does both."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterable, Iterator
from dataclasses import dataclass

from infomap_ros.geometry.config import check_config, parameter, setting
from infomap_ros.messages import header_stamp
from infomap_ros.replay.bags.reader import BagMessage

_NANOSECONDS = 1e9
_MESSAGES_PER_STEP = 64
_ACKNOWLEDGE_TIMEOUT = 5.0  # after which a message without its result counts as lost [s]


@dataclass(frozen=True)
class PlayerConfig:
    """Configuration of `BagPlayer`."""

    rate: float = parameter(
        1.0, "Speed of the replay as a multiple of the recording's.", low=0.001, high=1000.0
    )
    loop: bool = parameter(False, "Start again at the end; the clock then jumps back.")
    start_offset: float = parameter(
        0.0, "How much of the recording's beginning is left out.", unit="s", low=0.0
    )
    acknowledged: bool = parameter(
        False,
        "Play as fast as the results of the paced topics come back, whatever the recorded times.",
    )
    window: int = setting(
        2, "Messages of each paced topic that may be on their way at once.", low=1, high=1000
    )

    def __post_init__(self) -> None:
        check_config(self)


@dataclass(frozen=True)
class Step:
    """What to do now.

    Attributes:
        messages: to publish, in this order.
        clock: time of the recording for ``/clock`` [ns], to publish before the messages; None
            before the first message.
        wait: how long until the next step has something to do [s]; an acknowledgement can
            shorten that.
        finished: True when the bag has ended and is not looped.
    """

    messages: tuple[BagMessage, ...]
    clock: int | None
    wait: float
    finished: bool


class BagPlayer:
    """Plays a bag in the times of its recording, or as fast as its messages are acknowledged.

    Messages before `start_offset` are left out, except those of latched topics: they come first.
    When looping, the clock jumps back to the beginning of the recording.

    Attributes:
        loops: how many times the end was reached.
        published: number of messages given out.
        unacknowledged: number of paced messages whose result did not come back in time.
    """

    def __init__(
        self,
        open_messages: Callable[[], Iterable[BagMessage]],
        config: PlayerConfig | None = None,
        *,
        paced: Collection[str] = (),
        latched: Collection[str] = (),
    ) -> None:
        """Prepare to play; nothing is read before the first step.

        Args:
            open_messages: gives the messages from the beginning, in order of time.
            config: how to play.
            paced: topics whose messages have a header and are acknowledged by its stamp.
            latched: topics whose messages are published although they are before the start.
        """
        self.config = config or PlayerConfig()
        self._open = open_messages
        self._paced, self._latched = frozenset(paced), frozenset(latched)
        self.loops = self.published = self.unacknowledged = 0
        self._in_flight: dict[str, dict[int, float]] = {topic: {} for topic in self._paced}
        self._messages: Iterator[BagMessage] | None = None
        self._next: BagMessage | None = None
        self._first = 0  # receive time of the first message of the bag [ns]
        self._origin = math.nan  # caller's time at which the first message is due [s]
        self._paused_at: float | None = None
        self._clock: int | None = None

    def step(self, now: float) -> Step:
        """Say what is due.

        Args:
            now: time of the caller's steady clock [s].
        """
        if self._paused_at is not None:
            return Step((), self._clock, 0.1, False)
        if self._messages is None:
            self._rewind(now)
        self._give_up(now)
        due = self._take_due(now)
        self.published += len(due)
        if not self.config.acknowledged:
            self._clock = max(self._recording_time(now), due[-1].stamp if due else 0)
        elif due:
            self._clock = due[-1].stamp
        finished = self._at_end() and self._end(now)
        return Step(tuple(due), self._clock, 0.0 if finished else self._wait(now), finished)

    def acknowledge(self, topic: str, stamp: int) -> None:
        """The result of the paced message on `topic` with this header stamp [ns] has come back."""
        self._in_flight[topic].pop(stamp, None)

    def pause(self, now: float) -> None:
        """Hold the replay; time of the recording stands still."""
        if self._paused_at is None:
            self._paused_at = now

    def resume(self, now: float) -> None:
        """Go on after `pause`."""
        if self._paused_at is not None:
            self._origin += now - self._paused_at
            self._paused_at = None

    def _rewind(self, now: float) -> None:
        self._messages = iter(self._open())
        self._next = next(self._messages, None)
        if self._next is not None:
            self._first = self._next.stamp
        self._origin = now - self.config.start_offset / self.config.rate

    def _recording_time(self, now: float) -> int:
        elapsed = (now - self._origin) * self.config.rate
        return self._first + round(elapsed * _NANOSECONDS)

    def _take_due(self, now: float) -> list[BagMessage]:
        due: list[BagMessage] = []
        while self._next is not None and len(due) < _MESSAGES_PER_STEP:
            message = self._next
            if not self._is_skipped(message):
                if not self._is_due(message, now):
                    break
                self._send(message, now)
                due.append(message)
            self._next = next(self._messages, None) if self._messages else None
        return due

    def _is_skipped(self, message: BagMessage) -> bool:
        start = self._first + round(self.config.start_offset * _NANOSECONDS)
        return message.stamp < start and message.topic not in self._latched

    def _is_due(self, message: BagMessage, now: float) -> bool:
        if self.config.acknowledged:
            return len(self._in_flight.get(message.topic, ())) < self.config.window
        return message.stamp <= self._recording_time(now)

    def _send(self, message: BagMessage, now: float) -> None:
        if message.topic in self._paced and self.config.acknowledged:
            self._in_flight[message.topic][header_stamp(message.data)] = now

    def _give_up(self, now: float) -> None:
        for flying in self._in_flight.values():
            oldest = now - _ACKNOWLEDGE_TIMEOUT
            for stamp in [stamp for stamp, sent in flying.items() if sent <= oldest]:
                del flying[stamp]
                self.unacknowledged += 1

    def _at_end(self) -> bool:
        return self._next is None and not any(self._in_flight.values())

    def _end(self, now: float) -> bool:
        """Start again where that is wanted; True when it was the end."""
        self.loops += 1
        if not self.config.loop or self.published == 0:
            return True
        self._rewind(now)
        return False

    def _wait(self, now: float) -> float:
        if self._next is None or self.config.acknowledged:
            waiting = any(self._in_flight.values())
            return min(0.1, _ACKNOWLEDGE_TIMEOUT) if waiting else 0.0
        late = (self._next.stamp - self._recording_time(now)) / _NANOSECONDS
        return max(0.0, late / self.config.rate)
