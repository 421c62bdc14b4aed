"""One time for robots that are simulated apart: nobody runs ahead of the others.

There is no master. Each simulation tells its time; each waits where another one is behind by more
than a little. Who has not been heard for some while is taken to be switched off, and nobody waits
for it; when it comes back, it begins at the time of the others.
"""

from __future__ import annotations

from dataclasses import dataclass, field


@dataclass
class SharedTime:
    """The times of other simulations, as they are heard.

    Attributes:
        window: by how much a simulation may be ahead of another [s, simulated].
        silence: after which another simulation is taken to be switched off [s].
    """

    window: float
    silence: float
    _heard: dict[str, tuple[float, float]] = field(default_factory=dict, init=False)

    def hear(self, name: str, time: float, now: float) -> None:
        """A simulation tells its time.

        Args:
            name: of the other simulation.
            time: simulated [s].
            now: of any steady clock [s].
        """
        self._heard[name] = time, now

    def running(self, now: float) -> dict[str, float]:
        """Last known times of those that are not switched off [s, simulated], by name."""
        return {
            name: time for name, (time, heard) in self._heard.items() if now - heard < self.silence
        }

    def may_step(self, time: float, now: float) -> bool:
        """Whether a simulation that is at `time` [s] may go on, as nobody is too far behind."""
        return all(time < other + self.window for other in self.running(now).values())

    def missed(self, time: float, now: float) -> float:
        """By how much a simulation at `time` must skip ahead to be with the others [s].

        Others wait for those that are behind by little. Who is further behind was switched off.
        """
        ahead = max(self.running(now).values(), default=time) - time
        return ahead if ahead > 2.0 * self.window else 0.0
