"""Pair two streams by stamp."""

from __future__ import annotations

from collections import deque
from typing import Generic, TypeVar

from infomap_ros.geometry.records import Record

First = TypeVar("First", bound=Record)
Second = TypeVar("Second", bound=Record)
Either = TypeVar("Either", bound=Record)
Other = TypeVar("Other", bound=Record)


class StampPairing(Generic[First, Second]):
    """Match each record of one stream with the one of the other that was taken with it.

    What was taken together comes in the same order on both streams. So what came before a matched
    pair can never be paired any more and is dropped, whatever its stamp says: a stamp that is
    wrong, or a clock that jumps, costs the records that have it and no others.

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
        partner = self._take_partner(record, self._first, self._second)
        return None if partner is None else (record, partner)

    def add_second(self, record: Second) -> tuple[First, Second] | None:
        """Add a record of the second stream; returns the pair that it completes, if any."""
        partner = self._take_partner(record, self._second, self._first)
        return None if partner is None else (partner, record)

    def clear(self) -> int:
        """Forget all unpaired records, for example when the clock jumped; returns how many."""
        count = len(self._first) + len(self._second)
        self._first.clear()
        self._second.clear()
        self.unpaired += count
        return count

    def _take_partner(
        self, record: Either, earlier: deque[Either], others: deque[Other]
    ) -> Other | None:
        """The nearest in time among the others, or none: then the record waits.

        Of several with the same difference the one that came first is meant: a bag that starts
        again has each stamp twice.
        """
        gaps = [abs(other.stamp - record.stamp) for other in others]
        nearest = min(gaps, default=self._tolerance + 1)
        if nearest > self._tolerance:
            self._keep(record, earlier)
            return None
        self.unpaired += len(earlier)
        earlier.clear()
        for _ in range(gaps.index(nearest)):
            others.popleft()
            self.unpaired += 1
        return others.popleft()

    def _keep(self, record: Either, queue: deque[Either]) -> None:
        queue.append(record)
        if len(queue) > self._capacity:
            queue.popleft()
            self.unpaired += 1
