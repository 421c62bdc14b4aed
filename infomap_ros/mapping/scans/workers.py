"""Threads that share the work on one scan."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any


class Workers:
    """A fixed number of threads; with one, everything runs in the caller's.

    The kernels release the GIL. They are plain functions on parts of the work, not numba's own
    parallel loops, whose default threading layer does not bear calls from two threads.
    """

    def __init__(self, count: int) -> None:
        self.count = count
        self._pool = ThreadPoolExecutor(count) if count > 1 else None

    def run(self, task: Callable[[int, int, int], Any], size: int) -> None:
        """Run ``task(part, first, last)`` over [0, size), in one piece each."""
        if self._pool is None or size < 2 * self.count:
            task(0, 0, size)
            return
        cuts = [size * i // self.count for i in range(self.count + 1)]
        list(self._pool.map(task, range(self.count), cuts[:-1], cuts[1:]))

    def deal(
        self, task: Callable[[int, list[tuple[int, int]]], None], size: int, unit: int
    ) -> None:
        """Run ``task(part, strips)`` for every part, the strips (first, last) dealt out in turn.

        For work that is not spread evenly over [0, size), as an image with sky above.

        Args:
            task: may receive no strips.
            size: of the whole.
            unit: strips are cut at multiples of it.
        """
        height = size if self._pool is None else 4 * unit
        strips = [(first, min(first + height, size)) for first in range(0, size, height)]
        hands = [strips[part :: self.count] for part in range(self.count)]
        if self._pool is None:
            task(0, hands[0])
        else:
            list(self._pool.map(task, range(self.count), hands))

    def together(self, *tasks: Callable[[], None]) -> None:
        """Run tasks that do not touch each other's data, at once if there are threads."""
        if self._pool is None:
            for task in tasks:
                task()
            return
        for running in [self._pool.submit(task) for task in tasks]:
            running.result()
