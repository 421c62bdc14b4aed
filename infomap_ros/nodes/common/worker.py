"""One thread for work that is too long for an executor callback.

Kernels and OpenCV release the GIL while they work, so callbacks keep being served. The queue is
bounded: when jobs come faster than they are done, the oldest waiting one gives way to the newest
and is reported. Errors of the library, and any error that a message of another robot causes, are
for the job to translate; any other exception ends the thread, which its owner notices by `alive`
and must not survive.
"""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable

Job = Callable[[], object]


class Worker:
    """A thread that does jobs in order from a bounded queue.

    Args:
        name: of the thread.
        capacity: number of jobs that may wait; 1 means latest wins.
        on_overflow: called in the submitting thread for each job that gave way.
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
        self._waiting: deque[tuple[Job, bool]] = deque()
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
        """Queue a job; when the queue is full the oldest such job gives way."""
        with self._condition:
            replaceable = [entry for entry in self._waiting if entry[1]]
            overflow = len(replaceable) >= self._capacity
            if overflow:
                self._waiting.remove(replaceable[0])
            self._append(job, may_give_way=True)
        if overflow:
            self._on_overflow()

    def submit_always(self, job: Job) -> None:
        """Queue a job that never gives way, for example an order of the user."""
        with self._condition:
            self._append(job, may_give_way=False)

    def _append(self, job: Job, *, may_give_way: bool) -> None:
        self._waiting.append((job, may_give_way))
        self.most_waiting = max(self.most_waiting, len(self._waiting))
        self._condition.notify()

    def clear(self) -> int:
        """Forget the waiting jobs that may give way; returns how many."""
        with self._condition:
            kept = [entry for entry in self._waiting if not entry[1]]
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
                self._busy = False
                self._condition.wait_for(lambda: self._stopping or self._waiting)
                if self._stopping:
                    return
                job, _ = self._waiting.popleft()
                self._busy = True
            try:
                job()
            except Exception:
                if not self._stopping:
                    raise
            with self._condition:
                self._busy = False
                rests = not self._waiting
            if rests:
                self._on_rest()
