"""From ranked views to one with a way to it: the last part of Fig. 7."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from infomap_ros.geometry.config import check_config, setting
from infomap_ros.views.decision import RatedView
from infomap_ros.views.ranking.options import Options
from infomap_ros.views.ranking.rating import Cost
from infomap_ros.views.reach import Reachability, ReachResult


@dataclass(frozen=True)
class ApproachConfig:
    """Configuration of `Approach`.

    Raises:
        ConfigError: a value is out of its range.
    """

    attempts: int = setting(
        15, "To at most so many views a motion is planned before the choice gives up.", low=1
    )
    alternatives: ClassVar[int] = 3
    """Where the way turns out longer than it looked, at most so many views are compared by the
    way that each really takes.
    """
    elsewhere: ClassVar[float] = 0.4
    """Views nearer than this to one that could not be reached are tried after all others [m]."""

    min_progress: ClassVar[float] = 0.2
    """A partial approach counts only if it leads at least so far; a shorter one would be chosen
    again and again [m].
    """

    def __post_init__(self) -> None:
        check_config(self)


class Approach:
    """Plans motions to views in turn until one is reached; keeps the best partial approach.

    Attributes:
        index: of the view that is chosen, None as long as there is none.
        result: the way to it.
        is_over: a view is reached, or all attempts are spent.
        tried: the views to which a motion was planned.
    """

    def __init__(
        self,
        config: ApproachConfig,
        options: Options,
        cost: Cost,
        reachability: Reachability,
        compares: bool,
    ) -> None:
        """Set up.

        Args:
            config: limits.
            options: the views.
            cost: what a way costs.
            reachability: plans the motions.
            compares: whether scores count in full views, so that what a way costs can be taken off.
        """
        self.index: int | None = None
        self.result: ReachResult | None = None
        self.is_over = False
        self.tried: list[int] = []
        self._config, self._options, self._cost = config, options, cost
        self._reachability, self._compares = reachability, compares

    def try_in_turn(self, views: list[RatedView], order: list[int], first_wins: bool) -> None:
        """Plan to views, best first.

        A way that is longer than it looked lowers the score; the next views are then tried too, as
        long as they may still turn out better.

        Args:
            views: all views; gets the reasons.
            order: which to try.
            first_wins: the first is taken if it is reached at all.
        """
        waiting, best_score, reached = list(order), -np.inf, 0
        while waiting and len(self.tried) < self._config.attempts:
            index = waiting.pop(0)
            if views[index].score <= best_score or reached == self._config.alternatives:
                break
            self.tried.append(index)
            result = self._reachability.reach(views[index].pose)
            if result.reason or result.partial:
                self._put_down(views, index, result)
                waiting = self._elsewhere_first(index, waiting)
                continue
            reached += 1
            score = views[index].score - self._surcharge(views[index], index, result)
            if score > best_score:
                self.index, self.result, best_score = index, result, score
            if not self._compares or (first_wins and index == order[0]):
                break
        self.is_over = reached > 0 or len(self.tried) >= self._config.attempts

    def _put_down(self, views: list[RatedView], index: int, result: ReachResult) -> None:
        """Note why a view is not reached; the first partial approach is second best."""
        reason = result.reason or "the way does not lead all the way"
        views[index] = views[index].rejected(reason)
        leads_on = result.partial and result.travel >= self._config.min_progress
        if leads_on and self.index is None:
            self.index, self.result = index, result

    def _elsewhere_first(self, failed: int, waiting: list[int]) -> list[int]:
        """Views near one that is not reached are likely not reached either."""
        positions = self._options.positions
        gaps = np.linalg.norm(positions[waiting] - positions[failed], axis=1)
        near = gaps < self._config.elsewhere
        far = [i for i, is_near in zip(waiting, near, strict=True) if not is_near]
        return far + [i for i, is_near in zip(waiting, near, strict=True) if is_near]

    def _surcharge(self, view: RatedView, index: int, result: ReachResult) -> float:
        """What the way really costs beyond what the rating has assumed [full views]."""
        assumed = view.terms.get(self._cost.term.name, np.nan)
        return self._cost.surcharge(result, assumed, float(self._options.path_lengths[index]))
