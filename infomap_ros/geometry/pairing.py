"""Pair two streams by stamp."""

from __future__ import annotations

from collections import deque
from typing import Generic, TypeVar

from infomap_ros.geometry.records import Record

First = TypeVar("First", bound=Record)
Second = TypeVar("Second", bound=Record)
Either = TypeVar("Either", bound=Record)


class StampPairing(Generic[First, Second]):
    """Match each record of one stream with the one of the other that was taken with it.

    Within a stream stamps increase, so a record older than a matched pair can never be paired
    any more and is dropped.

    Args:
        tolerance: largest difference of the two stamps [ns]; 0 pairs equal stamps only.
        capacity: how many unpaired records of each stream are kept.

    Attributes:
        unpaired: how many records were dropped without a partner so far.
    """

    def __init__(self, tolerance: int = 0, capacity: int = 10) -> None:
        self._tolerance = tolerance
        self._capacity = capacity
        self._first: deque[First] = deque()
        self._second: deque[Second] = deque()
        self.unpaired = 0

    def add_first(self, record: First) -> tuple[First, Second] | None:
        """Add a record of the first stream; returns the pair that it completes, if any."""
        partner = self._nearest(record.stamp, self._second)
        if partner is None:
            self._keep(record, self._first)
            return None
        self._discard(record.stamp, partner.stamp)
        return record, partner

    def add_second(self, record: Second) -> tuple[First, Second] | None:
        """Add a record of the second stream; returns the pair that it completes, if any."""
        partner = self._nearest(record.stamp, self._first)
        if partner is None:
            self._keep(record, self._second)
            return None
        self._discard(partner.stamp, record.stamp)
        return partner, record

    def clear(self) -> int:
        """Forget all unpaired records, for example when the clock jumped; returns how many."""
        count = len(self._first) + len(self._second)
        self._first.clear()
        self._second.clear()
        self.unpaired += count
        return count

    def _nearest(self, stamp: int, others: deque[Either]) -> Either | None:
        near = [other for other in others if abs(other.stamp - stamp) <= self._tolerance]
        return min(near, key=lambda other: abs(other.stamp - stamp), default=None)

    def _discard(self, first_stamp: int, second_stamp: int) -> None:
        """Forget everything up to the matched pair; one of the two is among them."""
        removed = _pop_until(self._first, first_stamp) + _pop_until(self._second, second_stamp)
        self.unpaired += removed - 1

    def _keep(self, record: Either, queue: deque[Either]) -> None:
        queue.append(record)
        if len(queue) > self._capacity:
            queue.popleft()
            self.unpaired += 1


def _pop_until(queue: deque[Either], stamp: int) -> int:
    removed = 0
    while queue and queue[0].stamp <= stamp:
        queue.popleft()
        removed += 1
    return removed
