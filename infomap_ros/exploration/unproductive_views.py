"""Whether the last views have brought anything that the task asks for, and what comes next."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from infomap_ros.exploration.progress import MapProgress
from infomap_ros.exploration.robot import Choice
from infomap_ros.exploration.rules import Ending, EndReason, StopRule
from infomap_ros.exploration.task import TaskConfig
from infomap_ros.geometry.transforms import FloatArray


class UnproductiveViews(StopRule):
    """The last views have brought so little for their time that to go on is not worth it.

    What counts is how fast the entropy of the region falls, and the share of its surface rises that
    is known precisely enough, over a few views together, each against its best such rate: most of
    what a place tells is told early, and views that fill in the rest, a tenth of a percent after
    the other, could go on for hours. A map that becomes less certain, as by a correction, takes
    nothing from what other views have brought.

    Args:
        task: what is asked for.
    """

    def __init__(self, task: TaskConfig) -> None:
        self.task = task
        self._views, self._seconds, self._state = 0, 0.0, np.zeros(2)
        self._brought: list[FloatArray] = []  # bits, share of the surface and time of each view
        self._best = np.zeros(2)

    def note(self, views: int, seconds: float, progress: MapProgress) -> None:
        """Take the state of the map after so many views, and so much time, in any unit."""
        state = np.array([-progress.entropy_bits, progress.min_fraction])
        if views > self._views > 0:
            brought = np.maximum(state - self._state, 0.0)
            self._brought.append(np.append(brought, max(seconds - self._seconds, 0.0)))
            self._best = np.maximum(self._best, self._rates(self.task.unproductive_views))
        self._views, self._seconds, self._state = views, seconds, state

    def restart(self) -> None:
        """Count views from now on, against the best rates so far."""
        self._brought.clear()

    @property
    def is_last_unproductive(self) -> bool:
        """Whether the last view alone has brought less than is asked of several."""
        return bool(self._brought) and self._share(1) <= self.task.min_rate

    def ending(self, choice: Choice | None) -> Ending | None:
        """NOTHING_LEFT, with what the last views have brought."""
        reason = "" if choice is None else self.reason()
        return Ending(EndReason.NOTHING_LEFT, reason) if reason else None

    def reason(self) -> str:
        """How little the last views have brought; empty where it is enough."""
        count = self.task.unproductive_views
        if len(self._brought) < count or self._share(count) > self.task.min_rate:
            return ""
        bits, surface, _ = np.sum(self._brought[-count:], axis=0)
        return (
            f"the last {count} views told {bits:.0f} bits and made {100.0 * surface:.2f} % more of "
            f"the surface known precisely, {100.0 * self._share(count):.1f} % of the best rate"
        )

    def _rates(self, count: int) -> FloatArray:
        """Bits and share of the surface per time that the last views have brought together."""
        *brought, time = np.sum(self._brought[-count:], axis=0)
        return np.array(brought) / max(float(time), 1e-3)

    def _share(self, count: int) -> float:
        """Rate of the last views as a share of the best one, of bits or surface: the larger."""
        return float((self._rates(count) / np.maximum(self._best, 1e-12)).max())


class StrategyAlternator:
    """Two kinds of views take turns: each has its turn until its last views were in vain.

    They are those that tell most, and those that show most of the missing surface. Where a kind
    has half the limit of the task, an exploration that ends in vain has tried both.

    Args:
        task: what is asked for, and its limit.

    Attributes:
        is_other: whether it is the turn of the second kind.
    """

    def __init__(self, task: TaskConfig) -> None:
        self._task = replace(task, unproductive_views=max(task.unproductive_views // 2, 1))
        self._turn = UnproductiveViews(self._task)
        self.is_other = False

    def note(self, views: int, progress: MapProgress) -> None:
        """Take the state of the map after so many views."""
        self._turn.note(views, float(views), progress)
        if self._turn.reason():
            self.is_other = not self.is_other
            self._turn.restart()
