"""Whether the last views have brought anything that the task asks for, and what comes next."""

from __future__ import annotations

from dataclasses import replace

from infomap_ros.exploration.progress import MapProgress
from infomap_ros.exploration.robot import Choice
from infomap_ros.exploration.rules import Ending, EndReason, StopRule
from infomap_ros.exploration.task import TaskConfig


class UnproductiveViews(StopRule):
    """The last views together have brought too little to go on.

    What is known may come to be a smaller share when a view opens new ground, and surface voxels
    may turn out to be none; such a fall takes nothing from what other views have brought.

    Args:
        task: what is asked for.
    """

    def __init__(self, task: TaskConfig) -> None:
        self.task = task
        self._views, self._known, self._precise, self._surface = 0, 0.0, 0.0, 0
        self._gains: list[tuple[float, float]] = []  # shares, a pair per view

    def note(self, views: int, progress: MapProgress) -> None:
        """Take the state of the map after so many views."""
        if views > self._views:
            known = progress.known_fraction - self._known
            gain = max(known, progress.min_fraction - self._precise)
            growth = progress.surface_voxels / max(self._surface, 1) - 1.0
            self._gains.append((max(gain, 0.0), max(growth, 0.0)))
        self._views = views
        self._known, self._precise = progress.known_fraction, progress.min_fraction
        self._surface = max(self._surface, progress.surface_voxels)

    @property
    def is_last_unproductive(self) -> bool:
        """Whether the last view alone has brought less than is asked of several."""
        if not self._gains:
            return False
        gain, growth = self._gains[-1]
        return gain < self.task.min_gain and growth < self.task.min_growth

    def ending(self, choice: Choice | None) -> Ending | None:
        """NOTHING_LEFT, with what the last views have brought."""
        reason = "" if choice is None else self.reason()
        return Ending(EndReason.NOTHING_LEFT, reason) if reason else None

    def reason(self) -> str:
        """How little the last views have brought; empty where it is enough."""
        task = self.task
        if len(self._gains) < task.unproductive_views:
            return ""
        gain, growth = (
            sum(each) for each in zip(*self._gains[-task.unproductive_views :], strict=True)
        )
        if gain >= task.min_gain or growth >= task.min_growth:
            return ""
        return (
            f"the last {task.unproductive_views} views made {100.0 * gain:.2f} % more of the "
            f"surface known and {100.0 * growth:.1f} % more of it mapped"
        )


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
        self._turn.note(views, progress)
        if self._turn.reason():
            self.is_other = not self.is_other
            self._turn = UnproductiveViews(self._task)
            self._turn.note(views, progress)
