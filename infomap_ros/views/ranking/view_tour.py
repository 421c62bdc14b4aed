"""All that is left to see, in one tour: which views, and in which order."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from infomap_ros.geometry.config import check_config, setting
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.views.ranking import look_ahead_kernels, tour_kernels
from infomap_ros.views.ranking.look_ahead import LookAhead, distances_between, sharing_of
from infomap_ros.views.ranking.options import Options
from infomap_ros.views.ranking.rating import Ratings
from infomap_ros.views.ranking.strategy import Scores
from infomap_ros.views.sampling.surroundings import IntArray, Surroundings
from infomap_ros.views.situation import Situation


@dataclass(frozen=True)
class ViewTourConfig:
    """Configuration of `ViewTour`.

    Raises:
        ConfigError: a value is out of its range.
    """

    views: int = setting(20, "At most so many views are part of a tour.", low=1, high=60)
    firsts: ClassVar[int] = 6
    """Tours are compared that begin with so many of the best views."""
    discount_distance: float = setting(
        40.0,
        "Information that comes after a way of this distance (eq. 10) counts 1/e of what comes at "
        "once.",
        low=0.01,
        high=1e6,
    )
    cost_of_view: float = setting(
        0.3, "A view costs as much as a way of this distance.", low=0.0, high=1e6
    )
    min_share: ClassVar[float] = 0.01
    """A view that adds less than this to the others is no part of a tour [full views]."""

    def __post_init__(self) -> None:
        check_config(self)


class ViewTour:
    """Ranks a view by the best tour of all that is left to see that starts with it.

    First views are chosen that together tell most: each in turn by what it adds to the others (the
    greedy cover). What a view adds is its prize. The tour then takes those whose prizes are worth
    the way, in the order of the largest

        sum_i p_i exp(-D_i / discount_distance) - w_d D_last

    with D the distance of eq. (10) and w_d its weight in eq. (11): the prize-collecting traveling
    salesman (E. Balas 1989, doi:10.1002/net.3230190602), with a mild preference for what comes
    soon. A look ahead over few views takes the large gains one after the other and leaves small
    ones behind, to which the way back is long; a tour takes them as it passes.
    """

    requires_positive_utility = True

    def __init__(
        self, config: ViewTourConfig | None = None, first: LookAhead | None = None
    ) -> None:
        """Set up.

        Args:
            config: of the tour.
            first: makes the first ranking, of all views, by information of which not all is exact.
        """
        self.config, self._first = config or ViewTourConfig(), first or LookAhead()
        self._planned = np.empty((0, 4, 4))

    def propose(
        self, situation: Situation, surroundings: Surroundings, rng: np.random.Generator
    ) -> FloatArray:
        """The rest of the last tour, so that it goes on unless a better one is found."""
        return self._planned

    def score(self, options: Options, ratings: Ratings) -> Scores:
        """Worth of the best tour that starts with each view [full views, discounted].

        In the first ranking: the ratings, views that are like a better one after all others.
        """
        if not options.fine:
            return self._first.score(options, ratings)
        values = ratings.ratings - float(np.ptp(ratings.ratings)) - 1e3
        chosen, prizes = self._cover(options, ratings)
        plans: dict[int, tuple[int, ...]] = {}
        self._planned = np.empty((0, 4, 4))
        if not len(chosen):
            return Scores(values, plans)
        ways = ratings.ways[chosen], distances_between(options, ratings, chosen)
        look = 0.0 if ratings.cost.includes_look else self.config.cost_of_view
        weights = ratings.cost.weight_of_distance, look
        for utility, order in self._tours(prizes, *ways, *weights):
            first, *others = (int(chosen[view]) for view in order)
            if utility > values[first]:
                values[first], plans[first] = utility, tuple(others)
        self._planned = options.poses[list(plans[int(values.argmax())])]
        return Scores(values, plans)

    def _cover(self, options: Options, ratings: Ratings) -> tuple[IntArray, FloatArray]:
        """Views that together tell most, shape (K,), and what each adds to those before it."""
        every = np.arange(len(options))
        every = np.arange(len(options))
        sharing = sharing_of(options, every)
        told, chosen, prizes = np.zeros(sharing.size), list[int](), list[float]()
        safe = 1.0 - ratings.terms["risk"]
        utility = ratings.config.information_weight * ratings.shares * safe
        near = np.exp(-ratings.ways / self.config.discount_distance)
        while len(chosen) < min(self.config.views, len(options)):
            added = utility * [look_ahead_kernels.unshared(sharing, view, told) for view in every]
            added[chosen] = 0.0
            added[added < self.config.min_share] = 0.0
            best = int((added * near).argmax())
            if added[best] <= 0.0:
                break
            chosen.append(best)
            prizes.append(float(added[best]))
            look_ahead_kernels.tell(sharing, best, told)
        return np.array(chosen, np.int64), np.array(prizes)

    def _tours(
        self,
        prizes: FloatArray,
        first: FloatArray,
        between: FloatArray,
        weight: float,
        look: float,
    ) -> list[tuple[float, NDArray[np.int64]]]:
        """The best tour, and the best ones that start with each of a few views; and their worth."""
        config = self.config
        settings = np.array([config.discount_distance, weight, look])
        problem = first, between, prizes, settings
        best = self._tour(np.empty(0, np.int64), problem)
        alone = prizes * np.exp(-first / config.discount_distance)
        firsts = np.argsort(-alone, kind="stable")[: config.firsts]
        return [best, *(self._tour(np.array([view]), problem) for view in firsts)]

    def _tour(
        self,
        begin: NDArray[np.int64],
        problem: tuple[FloatArray, FloatArray, FloatArray, FloatArray],
    ) -> tuple[float, NDArray[np.int64]]:
        """A tour that begins with the given views, and its worth; at least one view."""
        order = np.zeros(len(problem[0]), np.int64)
        order[: len(begin)] = begin
        fixed = len(begin)
        count = tour_kernels.build_tour(order, fixed, fixed, *problem)
        if count == 0:
            return self._tour(np.array([int(problem[2].argmax())]), problem)
        utility = tour_kernels.improve_tour(order, count, fixed, *problem)
        return float(utility), order[:count]
