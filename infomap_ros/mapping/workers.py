"""Threads that share the work on one scan."""

from __future__ import annotations

import math
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

    def run(self, task: Callable[[int, int, int], Any], size: int, unit: int = 1) -> None:
        """Run ``task(part, first, last)`` over [0, size), cut at multiples of `unit`."""
        if self._pool is None or size < 2 * unit:
            task(0, 0, size)
            return
        cuts = [
            min(size, math.ceil(size * i / self.count / unit) * unit) for i in range(self.count + 1)
        ]
        list(self._pool.map(task, range(self.count), cuts[:-1], cuts[1:]))

    def together(self, *tasks: Callable[[], None]) -> None:
        """Run tasks that do not touch each other's data, at once if there are threads."""
        if self._pool is None:
            for task in tasks:
                task()
            return
        for running in [self._pool.submit(task) for task in tasks]:
            running.result()
