"""Joint positions by time: where was the arm when this image was taken?"""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Collection
from dataclasses import dataclass, field

import numpy as np

from infomap_ros.errors import PoseUnavailableError
from infomap_ros.geometry.config import check_config, setting
from infomap_ros.geometry.records import JointStateRecord

_NANOSECONDS = 1_000_000_000
_MOST_JOINTS = 1000
_STILL = 1e-3  # a joint that moved by no more stood still [rad or m]


@dataclass(frozen=True)
class JointBufferConfig:
    """Configuration of `JointBuffer`.

    Raises:
        ConfigError: a value is out of its range.
    """

    max_gap: float = setting(
        0.5,
        "Longest time between two joint states across which a position is interpolated.",
        unit="s",
        low=0.0,
        high=3600.0,
    )
    capacity: int = setting(
        1000, "Number of positions that are kept of each joint.", low=2, high=1_000_000
    )

    def __post_init__(self) -> None:
        check_config(self)


@dataclass
class _Series:
    stamps: list[int] = field(default_factory=list)
    positions: list[float] = field(default_factory=list)


class JointBuffer:
    """Positions of joints in order of time, and those between two of them.

    Several publishers may each know some of the joints. Positions are interpolated linearly
    between two neighbors at most `max_gap` apart, and never extrapolated. A joint state older
    than the newest of its joint by more than `max_gap` says that the clock was set back: what was
    kept of that joint is forgotten. Of more than a thousand joints the one that has been silent
    for longest is forgotten.
    """

    def __init__(self, config: JointBufferConfig | None = None) -> None:
        self.config = config or JointBufferConfig()
        self._max_gap = round(self.config.max_gap * _NANOSECONDS)
        self._series: dict[str, _Series] = {}

    def __len__(self) -> int:
        return len(self._series)

    def clear(self) -> None:
        """Forget everything."""
        self._series.clear()

    def add(self, state: JointStateRecord) -> None:
        """Keep a joint state."""
        for name, position in zip(state.names, state.positions, strict=True):
            series = self._series.setdefault(name, _Series())
            if series.stamps and state.stamp < series.stamps[-1] - self._max_gap:
                series.stamps.clear()
                series.positions.clear()
            self._insert(series, state.stamp, float(position))
        if len(self._series) > _MOST_JOINTS:
            by_age = sorted(self._series.items(), key=lambda item: item[1].stamps[-1])
            self._series = dict(by_age[-_MOST_JOINTS:])

    def _insert(self, series: _Series, stamp: int, position: float) -> None:
        place = bisect_left(series.stamps, stamp)
        if place < len(series.stamps) and series.stamps[place] == stamp:
            series.positions[place] = position
            return
        series.stamps.insert(place, stamp)
        series.positions.insert(place, position)
        if len(series.stamps) > self.config.capacity:
            del series.stamps[0], series.positions[0]

    def newest(self) -> dict[str, float]:
        """Newest position of each joint, by name [rad or m]; empty before the first."""
        return {name: series.positions[-1] for name, series in self._series.items()}

    def velocities(self) -> dict[str, float]:
        """Velocity of each joint between its two newest positions, by name [rad/s or m/s].

        A joint of which one position is known has none.
        """
        return {
            name: (series.positions[-1] - series.positions[-2])
            * _NANOSECONDS
            / (series.stamps[-1] - series.stamps[-2])
            for name, series in self._series.items()
            if len(series.stamps) > 1
        }

    def at(self, stamp: int, needed: Collection[str] = ()) -> dict[str, float]:
        """Positions of the joints that are known at a time, by name [rad or m].

        A joint that fell silent while others go on, as a gripper that is told of on change, stands
        where it was. One whose next position may be on its way is waited for.

        Args:
            stamp: [ns].
            needed: joints of which that is not enough, if anything was ever heard of them.

        Raises:
            PoseUnavailableError: no joint, or not a needed one, is known at that time; its
                `may_arrive` says whether a later joint state can change that.
        """
        if not self._series:
            reason = "no joint states"
            raise PoseUnavailableError("no joint state has arrived", reason, may_arrive=True)
        found: dict[str, float] = {}
        missing: dict[str, PoseUnavailableError] = {}
        for name in self._series:
            try:
                found[name] = self._position(name, stamp)
            except PoseUnavailableError as error:
                missing[name] = error
        newest = max((self._series[name].stamps[-1] for name in found), default=stamp)
        problems = [missing[name] for name in needed if name in missing]
        if newest <= stamp + self._max_gap:  # the next positions of others may still come too
            problems += [missing[name] for name in missing if self._is_just_beyond(name, stamp)]
        if problems:
            raise min(problems, key=lambda problem: problem.may_arrive)
        if not found:
            raise max(missing.values(), key=lambda problem: problem.may_arrive)
        held = {name: self._held(name, stamp) for name in missing}
        return found | {name: at for name, at in held.items() if at is not None}

    def _is_just_beyond(self, name: str, stamp: int) -> bool:
        """Whether a time is so little after the last position of a joint that it may go on."""
        return 0 < stamp - self._series[name].stamps[-1] <= self._max_gap

    def _held(self, name: str, stamp: int) -> float | None:
        """Where a joint stood that was silent then; None where it moved or was not heard of."""
        series = self._series[name]
        place = bisect_left(series.stamps, stamp)
        around = series.positions[max(place - 1, 0) : place + 1]
        return around[-1] if place > 0 and np.ptp(around) <= _STILL else None

    def _position(self, name: str, stamp: int) -> float:
        series = self._series[name]
        stamps, positions = series.stamps, series.positions
        place = bisect_left(stamps, stamp)
        if place < len(stamps) and stamps[place] == stamp:
            return positions[place]
        if place in (0, len(stamps)):
            side = "before the first" if place == 0 else "after the last"
            text = f"stamp {stamp} ns is {side} joint state of '{name}'"
            raise PoseUnavailableError(text, "joint states", may_arrive=place > 0)
        gap = stamps[place] - stamps[place - 1]
        if gap > self._max_gap:
            text = f"stamp {stamp} ns lies in a gap of {gap / _NANOSECONDS:.3f} s of '{name}'"
            raise PoseUnavailableError(text, "gap between joint states")
        fraction = (stamp - stamps[place - 1]) / gap
        return (1.0 - fraction) * positions[place - 1] + fraction * positions[place]
