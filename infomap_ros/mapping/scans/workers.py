"""Threads that share the work on one scan."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor, wait
from functools import partial
from typing import Any

_PIECES = 3
"""Pieces per thread into which `Workers.share` cuts a task."""


class Workers:
    """A fixed number of threads, that of the caller included; with one, there is no other.

    The kernels release the GIL. They are plain functions on parts of the work, not numba's own
    parallel loops, whose default threading layer does not bear calls from two threads.
    """

    def __init__(self, count: int) -> None:
        self.count = count
        self._pool = ThreadPoolExecutor(count - 1) if count > 1 else None

    def run(self, task: Callable[[int, int, int], Any], size: int) -> None:
        """Run ``task(part, first, last)`` over [0, size), in one piece each."""
        parts = self.count if size >= 2 * self.count else 1
        cuts = [size * i // parts for i in range(parts + 1)]
        self.together(*(partial(task, i, cuts[i], cuts[i + 1]) for i in range(parts)))

    def share(self, *tasks: tuple[Callable[[int, int], Any], int]) -> None:
        """Run each ``task(first, last)`` over [0, its size), in pieces for whoever is free.

        For work that is not spread evenly. The tasks do not touch each other's data.
        """
        pieces = deque[Callable[[], Any]]()
        for task, size in tasks:
            count = 1 if self._pool is None else max(1, min(_PIECES * self.count, size // 2))
            cuts = [size * i // count for i in range(count + 1)]
            pieces.extend(partial(task, *cuts[i : i + 2]) for i in range(count))

        def work() -> None:
            while pieces:
                try:
                    piece = pieces.popleft()
                except IndexError:  # another thread has taken the last
                    return
                piece()

        self.together(*([work] * self.count))

    def together(self, *tasks: Callable[[], Any]) -> None:
        """Run tasks that do not touch each other's data, at once if there are threads.

        The first is the caller's, which should be the longest, as another thread begins later.
        """
        if self._pool is None:
            for task in tasks:
                task()
            return
        running = [self._pool.submit(task) for task in tasks[1:]]
        try:
            tasks[0]()
        finally:
            wait(running)
        for done in running:
            done.result()
