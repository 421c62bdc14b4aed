"""Records that come in two messages of one stamp: poses and their uncertainty, say."""

from __future__ import annotations

from collections.abc import Callable
from typing import Generic, TypeVar

Main = TypeVar("Main")
Part = TypeVar("Part")

_CAPACITY = 100  # of each kind; older ones give way


class StampedParts(Generic[Main, Part]):
    """Completes records with the parts of the same stamp, whichever comes first.

    A record waits for its part where parts are published. It goes on without its part when a later
    record is complete, or when too many wait.

    Args:
        are_published: whether there are parts to wait for.
    """

    def __init__(self, are_published: Callable[[], bool]) -> None:
        self._are_published = are_published
        self._mains: dict[int, Main] = {}
        self._parts: dict[int, Part] = {}

    def add(self, stamp: int, record: Main) -> list[tuple[Main, Part | None]]:
        """Add a record; returns those that can go on, with their parts, in order of arrival."""
        self._mains[stamp] = record
        if stamp in self._parts or not self._are_published() or len(self._mains) > _CAPACITY:
            return self._complete(stamp)
        return []

    def add_part(self, stamp: int, part: Part) -> list[tuple[Main, Part | None]]:
        """Add a part; returns as `add`."""
        self._parts[stamp] = part
        while len(self._parts) > _CAPACITY:
            del self._parts[next(iter(self._parts))]
        return self._complete(stamp) if stamp in self._mains else []

    def _complete(self, stamp: int) -> list[tuple[Main, Part | None]]:
        """All records up to one stamp."""
        done = []
        for each in list(self._mains):
            done.append((self._mains.pop(each), self._parts.pop(each, None)))
            if each == stamp:
                break
        return done
