"""Which version a robot has reached, and which others may say that it has.

A robot whose clock went back since its last start learns from the others which versions it has
sent, and goes on after them. Who lies about that could send it so far ahead that nobody follows it
any more, so it follows only as far as the others follow it:

- before it has sent anything, half a year beyond its clock (`_BEYOND_CLOCK`), or wherever two
  robots say at the same time that it was;
- afterwards, no further than others let a robot go on that they follow (`membership.MOST_AHEAD`).
"""

from __future__ import annotations

import numpy as np

from infomap_ros.team.membership import MOST_AHEAD
from infomap_ros.team.update import CLOCK_RATE, COUNT, is_newer, next_version, versions_ahead

MOST_FOLLOWED = MOST_AHEAD // 2
"""Versions beyond the first sent one that a robot follows; others may have missed that one."""

_BEYOND_CLOCK = 1 << 29  # versions; a quarter of those that count as newer
_AT_ONCE = 10.0  # [s] within which two robots say the same


class OwnVersion:
    """The version of this robot's last publication.

    Args:
        version: to begin with.

    Attributes:
        number: the version.
    """

    def __init__(self, version: int) -> None:
        self.number, self._start, self._began = version, version, np.nan
        self._first: int | None = None
        self._claims: dict[int, tuple[int, float]] = {}

    def advance(self) -> int:
        """The next version, which is sent."""
        self.number = next_version(self.number)
        self._first = self.number if self._first is None else self._first
        return self.number

    def follow(self, version: int, sender: int, now: float) -> None:
        """Go on after a version that another robot says was sent, if that can be.

        Args:
            version: which is said.
            sender: id of who says it.
            now: time of any steady clock [s].
        """
        self._began = now if np.isnan(self._began) else self._began
        if not version or not is_newer(np.uint32(version), np.uint32(self.number)):
            self._claims.pop(sender, None)
            return
        if not self._may_be(version, now):
            self._claims[sender] = version, now
            version = self.number if self._first is not None else self._said_by_two(now)
        if is_newer(np.uint32(version), np.uint32(self.number)):
            self.number = version

    def barred_by(self, now: float) -> dict[int, int]:
        """Robots that hold a version of this robot that it does not follow, with that version.

        What this robot sends does not count there.
        """
        return {
            robot: version
            for robot, (version, at) in self._claims.items()
            if now - at <= _AT_ONCE and is_newer(np.uint32(version), np.uint32(self.number))
        }

    def _may_be(self, version: int, now: float) -> bool:
        if self._first is not None:
            return versions_ahead(version, self._first) <= MOST_FOLLOWED
        clock = (self._start + int(CLOCK_RATE * (now - self._began))) % COUNT
        return versions_ahead(version, clock) <= _BEYOND_CLOCK

    def _said_by_two(self, now: float) -> int:
        """The lower one of two versions that were said lately, or the own one."""
        said = sorted(
            versions_ahead(version, self.number)
            for version, at in self._claims.values()
            if now - at <= _AT_ONCE
        )
        return (self.number + said[-2] - 1) % (COUNT - 1) + 1 if len(said) > 1 else self.number
