"""One thread for work that is too long for an executor callback.

Kernels and OpenCV release the GIL while they work, so callbacks keep being served. The queue is
bounded: when jobs come faster than they are done, the oldest waiting one gives way to the newest
and is reported; of messages of other robots, the oldest one of the robot of which most waits.
Errors of the library, and any error that a message of another robot causes, are for the job to
translate; any other exception ends the thread, which its owner notices by `alive` and must not
survive.
"""

from __future__ import annotations

import threading
from collections import Counter, deque
from collections.abc import Callable
from typing import NamedTuple

Job = Callable[[], object]
MOST_WAITING = 64_000_000
"""Bytes of messages of other robots that may wait.

A dozen seconds of what one robot tells at the most, as long as a view takes to be chosen.
"""
_JOB_BYTES = 4000  # what a job takes beside its message, about


class _Entry(NamedTuple):
    """A job that waits; `source` and `size` of one for a message of another robot."""

    job: Job
    replaceable: bool
    source: str = ""
    size: int = 0


class Worker:
    """A thread that does jobs in order from a bounded queue.

    Args:
        name: of the thread.
        capacity: number of jobs that may wait; 1 means latest wins.
        on_overflow: called in the submitting thread for each job that was dropped.
        last_job: longest wait for the job at hand when it is stopped [s].
        on_rest: called in the worker's thread when no job is left.

    Attributes:
        most_waiting: largest number of jobs that have waited at once so far.
    """

    def __init__(
        self,
        name: str,
        capacity: int,
        on_overflow: Callable[[], None],
        last_job: float = 10.0,
        on_rest: Callable[[], None] = lambda: None,
    ) -> None:
        self.most_waiting = 0
        self._last_job = last_job
        self._capacity = capacity
        self._on_overflow, self._on_rest = on_overflow, on_rest
        self._waiting: deque[_Entry] = deque()
        self._sizes: Counter[str] = Counter()
        self._condition = threading.Condition()
        self._stopping = False
        self._busy = False
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)
        self._thread.start()

    @property
    def alive(self) -> bool:
        """Whether the thread can still work."""
        return self._thread.is_alive()

    @property
    def waiting(self) -> int:
        """Number of jobs that wait or run."""
        with self._condition:
            return len(self._waiting) + int(self._busy)

    def submit(self, job: Job) -> None:
        """Queue a job; when the queue is full, all such jobs that wait are dropped.

        A queue absorbs a burst. Who lags behind for long would else do every job a whole queue too
        late, when nobody waits for the result any more.
        """
        with self._condition:
            replaceable = sum(entry.replaceable for entry in self._waiting)
            dropped = self._forget_replaceable() if replaceable >= self._capacity else 0
            self._append(_Entry(job, replaceable=True))
        for _ in range(dropped):
            self._on_overflow()

    def submit_always(self, job: Job) -> None:
        """Queue a job that never is dropped, for example an order of the user."""
        with self._condition:
            self._append(_Entry(job, replaceable=False))

    def submit_from(self, source: str, size: int, job: Job) -> None:
        """Queue a job for a message of another robot.

        Args:
            source: which robot; where too much waits, the oldest job of who has most is dropped.
            size: of the message [bytes].
            job: what to do.
        """
        dropped = 0
        with self._condition:
            self._append(_Entry(job, False, source, size + _JOB_BYTES))
            self._sizes[source] += size + _JOB_BYTES
            while self._sizes.total() > MOST_WAITING:
                ((most, _),) = self._sizes.most_common(1)
                oldest = next(entry for entry in self._waiting if entry.source == most)
                self._waiting.remove(oldest)
                self._forget(oldest)
                dropped += 1
        for _ in range(dropped):
            self._on_overflow()

    def _forget(self, entry: _Entry) -> None:
        """An entry waits no more."""
        if entry.source:
            self._sizes[entry.source] -= entry.size
            if self._sizes[entry.source] <= 0:
                del self._sizes[entry.source]

    def _append(self, entry: _Entry) -> None:
        self._waiting.append(entry)
        self.most_waiting = max(self.most_waiting, len(self._waiting))
        self._condition.notify()

    def clear(self) -> int:
        """Forget the waiting jobs that are replaceable; returns how many."""
        with self._condition:
            return self._forget_replaceable()

    def _forget_replaceable(self) -> int:
        kept = [entry for entry in self._waiting if not entry.replaceable]
        forgotten = len(self._waiting) - len(kept)
        self._waiting = deque(kept)
        return forgotten

    def stop(self) -> None:
        """Finish the job at hand, forget the others, and end the thread.

        A job that takes longer than is waited for may fail on what is closed meanwhile.
        """
        with self._condition:
            self._stopping = True
            self._waiting.clear()
            self._condition.notify()
        self._thread.join(self._last_job)

    def _run(self) -> None:
        while True:
            with self._condition:
                self._condition.wait_for(lambda: self._stopping or self._waiting)
                if self._stopping:
                    return
                entry = self._waiting.popleft()
                self._forget(entry)
                self._busy = True
            try:
                entry.job()
            except Exception:
                if not self._stopping:
                    raise
            with self._condition:
                self._busy = False
                rests = not self._waiting
            if rests:
                self._on_rest()
