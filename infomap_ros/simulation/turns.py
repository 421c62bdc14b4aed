"""Threads that run one at a time, always the one whose clock is furthest behind.

Robots in one simulated world each think in a thread of their own. At any moment only one of them
goes on, and which one only their simulated times say, not how fast the machine is.

One time for robots that are simulated apart: nobody runs ahead of the others.

There is no master. Each simulation reports its time; each waits where another one is behind by more
than a little. Who has sent nothing for some while is taken to be switched off, and nobody waits
for it; when it comes back, it begins at the time of the others.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field


class SwitchedOff(BaseException):
    """Raised in a robot's thread, wherever it waits, when the robot is switched off."""


class Turns:
    """Who may run.

    Args:
        names: of those that take turns; of two at the same time the first one runs.
    """

    def __init__(self, names: tuple[str, ...]) -> None:
        self._changed = threading.Condition()
        self._order = {name: index for index, name in enumerate(names)}
        self._times: dict[str, float] = {}
        self._doomed: set[str] = set()
        self._error: BaseException | None = None

    def run(self, tasks: Mapping[str, Callable[[], None]]) -> None:
        """Run tasks to their ends, in a thread each.

        Raises:
            BaseException: what one of the tasks raised; the others are switched off then.
        """
        self._times = dict.fromkeys(tasks, 0.0)
        threads = [
            threading.Thread(target=self._run_one, args=item, name=item[0])
            for item in tasks.items()
        ]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        if self._error is not None:
            raise self._error

    def pass_on(self, name: str, time: float) -> None:
        """Let those run whose time is before `time` [s], to which `name` has come.

        Raises:
            SwitchedOff: `switch_off` was called for it, or another task has failed.
        """
        with self._changed:
            if name not in self._times:
                return
            self._times[name] = time
            self._wait_for_turn(name)

    @property
    def failed(self) -> bool:
        """Whether a task has failed, so that all are broken off."""
        return self._error is not None

    def switch_off(self, name: str) -> None:
        """Break a task off at its next turn, once."""
        with self._changed:
            self._doomed.add(name)

    def _run_one(self, name: str, task: Callable[[], None]) -> None:
        try:
            with self._changed:
                self._wait_for_turn(name)
            task()
        except BaseException as error:  # handed on to `run`, whatever it is
            with self._changed:
                self._error = self._error or error
        finally:
            with self._changed:
                del self._times[name]
                self._changed.notify_all()

    def _wait_for_turn(self, name: str) -> None:
        self._changed.notify_all()
        self._changed.wait_for(lambda: self._error is not None or self._is_turn_of(name))
        if self._error is not None or name in self._doomed:
            self._doomed.discard(name)
            raise SwitchedOff(name)

    def _is_turn_of(self, name: str) -> bool:
        key = (self._times[name], self._order[name])
        return all(key <= (time, self._order[other]) for other, time in self._times.items())


@dataclass
class SharedTime:
    """The times of other simulations, as they are received.

    Attributes:
        window: by how much a simulation may be ahead of another [s, simulated].
        silence: after which another simulation is taken to be switched off [s].
    """

    window: float
    silence: float
    _times: dict[str, tuple[float, float]] = field(default_factory=dict, init=False)

    def receive(self, name: str, time: float, now: float) -> None:
        """A simulation reports its time.

        Args:
            name: of the other simulation.
            time: simulated [s].
            now: of any steady clock [s].
        """
        self._times[name] = time, now

    def running(self, now: float) -> dict[str, float]:
        """Last known times of those that are not switched off [s, simulated], by name."""
        return {name: time for name, (time, at) in self._times.items() if now - at < self.silence}

    def may_step(self, time: float, now: float) -> bool:
        """Whether a simulation that is at `time` [s] may go on, as nobody is too far behind."""
        return all(time < other + self.window for other in self.running(now).values())

    def missed(self, time: float, now: float) -> float:
        """By how much a simulation at `time` must skip ahead to be with the others [s].

        Others wait for those that are behind by little. Who is further behind was switched off.
        """
        ahead = max(self.running(now).values(), default=time) - time
        return ahead if ahead > 2.0 * self.window else 0.0
