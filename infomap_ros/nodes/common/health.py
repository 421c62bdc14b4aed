"""What a node knows of its own condition: rates and ages of inputs, dropped data, output rate.

Ages are measured on the monotonic clock of the machine, so that a paused or looping bag does not
confuse them.
"""

from __future__ import annotations

import threading
import time
from collections import Counter, deque
from collections.abc import Callable, Collection, Iterable
from dataclasses import dataclass, field

STALE_AFTER = 5.0  # [s]
WARNING_PERIOD = 5.0  # [s], between two log lines on the same reason
_LONGEST_DETAIL = 500  # letters that are reported of a drop
_MOST_JOINTS = 1000  # whose names are known
_WINDOW = 50  # arrivals from which a rate is computed


def as_line(text: str) -> str:
    """A text as logs, terminals and pages may show it: one printable line that is not too long."""
    return "".join(c if c.isprintable() else repr(c)[1:-1] for c in text[:_LONGEST_DETAIL])


@dataclass
class Stream:
    """Arrivals on one topic.

    Attributes:
        topic: its full name.
        required: whether the node cannot work without it.
        latched: sent once; such a topic can be missing, never stale.
        since: when watching began [s, monotonic].
        arrivals: times of the last arrivals [s, monotonic].
        count: number of all arrivals.
        has_stopped: whether it was said that nothing comes any more.
    """

    topic: str
    required: bool
    latched: bool
    since: float
    arrivals: deque[float] = field(default_factory=lambda: deque(maxlen=_WINDOW))
    count: int = 0
    has_stopped: bool = False

    def rate(self, now: float) -> float:
        """Mean rate of the last arrivals until now [Hz]; 0 below two arrivals."""
        if len(self.arrivals) < 2:
            return 0.0
        span = max(now - self.arrivals[0], 1e-9)
        return (len(self.arrivals) - 1) / span

    def age(self, now: float) -> float:
        """Time since the last arrival, or since watching began [s]."""
        return now - (self.arrivals[-1] if self.arrivals else self.since)

    def complaint(self, now: float) -> str | None:
        """What is wrong with this input, in words; None when all is well."""
        age = self.age(now)
        if not self.required or age < STALE_AFTER:
            return None
        if not self.count:
            return f"no message on {self.topic} yet ({age:.0f} s)"
        return None if self.latched else f"no message on {self.topic} for {age:.0f} s"


class Health:
    """Counters of a node, safe to use from its callbacks and its worker.

    Args:
        clock: monotonic time [s].
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._lock = threading.Lock()
        self._streams: dict[str, Stream] = {}
        self._drops: Counter[str] = Counter()
        self._last_detail: dict[str, str] = {}
        self._notes: dict[str, str] = {}
        self._quiet_until: dict[str, float] = {}
        self._reported: Counter[str] = Counter()
        self._warned_missing = -WARNING_PERIOD
        self._condition = ""
        self._joints: dict[str, float] = {}
        self.needed_joints: Collection[str] = ()  # without which the node cannot work
        self._outputs = Stream("", required=False, latched=False, since=clock())

    def watch(self, topic: str, *, required: bool, latched: bool = False) -> None:
        """Expect messages on `topic`."""
        self._streams[topic] = Stream(topic, required, latched, self._clock())

    def arrived(self, topic: str) -> None:
        """A message came on `topic`."""
        with self._lock:
            stream = self._streams[topic]
            stream.arrivals.append(self._clock())
            stream.count += 1
            stream.has_stopped = False

    def note_joints(self, joints: Iterable[str]) -> None:
        """A joint state has come with these."""
        with self._lock:
            if len(self._joints) > _MOST_JOINTS:
                self._joints.clear()
            self._joints |= dict.fromkeys(joints, self._clock())

    def _silent_joints(self) -> list[str]:
        """Joints of which nothing has come for long, while others go on."""
        newest = max(self._joints.values(), default=0.0)
        return [name for name, last in self._joints.items() if newest - last >= STALE_AFTER]

    def produced(self) -> None:
        """The node has made one of its results."""
        with self._lock:
            self._outputs.arrivals.append(self._clock())
            self._outputs.count += 1

    def dropped(self, reason: str, detail: str = "") -> bool:
        """Count data that were not used.

        Args:
            reason: one of a few short names.
            detail: what exactly was wrong.

        Returns:
            Whether it is time to log this reason again.
        """
        now = self._clock()
        with self._lock:
            self._drops[reason] += 1
            self._last_detail[reason] = detail
            if now < self._quiet_until.get(reason, now):
                return False
            self._quiet_until[reason] = now + WARNING_PERIOD
        return True

    def note(self, name: str, value: str) -> None:
        """Set a figure of the node's own, for example the size of its map."""
        with self._lock:
            self._notes[name] = value

    def condition(self, text: str) -> None:
        """Say in words what is wrong with the node's results now; empty when nothing is."""
        with self._lock:
            self._condition = text

    def drops(self) -> dict[str, int]:
        """Number of drops by reason."""
        with self._lock:
            return dict(self._drops)

    def results(self) -> int:
        """Number of results so far."""
        return self._outputs.count

    def missing(self) -> list[str]:
        """Topics of required inputs on which nothing has come yet."""
        return [s.topic for s in self._streams.values() if s.required and not s.count]

    def newly_missing(self) -> tuple[list[str], list[str]]:
        """What is to be said of required inputs now, so that it is neither missed nor repeated.

        Returns:
            Topics on which nothing has come yet, at most every `WARNING_PERIOD`; and topics on
            which nothing comes any more, once.
        """
        now = self._clock()
        with self._lock:
            late = [s for s in self._streams.values() if s.complaint(now) is not None]
            never = [s.topic for s in late if not s.count]
            stopped = [s for s in late if s.count and not s.has_stopped]
            for stream in stopped:
                stream.has_stopped = True
            if now < self._warned_missing + WARNING_PERIOD:
                never = []
            elif never:
                self._warned_missing = now
        return never, [stream.topic for stream in stopped]

    def complaints(self) -> list[str]:
        """What is wrong now: with results and inputs, and what was dropped since the last call."""
        now = self._clock()
        with self._lock:
            found = [s.complaint(now) for s in self._streams.values()]
            recent = self._drops - self._reported
            self._reported = self._drops.copy()
            condition = [self._condition] if self._condition else []
            silent = set(self._silent_joints()).intersection(self.needed_joints)
            condition += [f"nothing comes of joint {name} any more" for name in sorted(silent)]
        dropped = [f"dropped {count}: {reason}" for reason, count in recent.items()]
        return condition + [text for text in found if text is not None] + dropped

    def values(self) -> dict[str, str]:
        """All figures, for a diagnostic message."""
        now = self._clock()
        figures = {}
        with self._lock:
            for stream in self._streams.values():
                figures[f"{stream.topic} rate [Hz]"] = f"{stream.rate(now):.2f}"
                figures[f"{stream.topic} count"] = str(stream.count)
                age = f"{stream.age(now):.2f}" if stream.count else "never"
                figures[f"{stream.topic} age [s]"] = age
            if silent := self._silent_joints():
                figures["silent joints"] = as_line(", ".join(silent))
            figures["results"] = str(self._outputs.count)
            figures["results rate [Hz]"] = f"{self._outputs.rate(now):.2f}"
            for reason, count in self._drops.items():
                figures[f"dropped: {reason}"] = str(count)
                if self._last_detail[reason]:
                    figures[f"last drop: {reason}"] = self._last_detail[reason]
            figures.update(self._notes)
        return figures
