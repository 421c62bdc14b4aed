"""From ranked candidates to one view: the second half of Fig. 7 of Sujan and Dubowsky 2005."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from infomap_ros.errors import InvalidInputError
from infomap_ros.geometry.config import check_config, setting
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.views.decision import RatedView, Reachability, ReachResult, Stopwatch
from infomap_ros.views.ranking.options import Options
from infomap_ros.views.ranking.rating import Cost, Rating, Ratings
from infomap_ros.views.ranking.strategy import Scores, Strategy
from infomap_ros.views.sampling.surroundings import IntArray

LEFT_TO_TEAMMATE = "a teammate is about to see most of it"

KnownUnreachable = Callable[[FloatArray], Sequence[str]]
"""Reasons not to try views again: (M, 4, 4) -> M texts, "" where nothing is known against it."""


@dataclass(frozen=True)
class SelectionConfig:
    """Configuration of `Selection`.

    Raises:
        ConfigError: a value is out of its range.
    """

    refined: int = setting(
        40,
        "The best so many of the views that the robot may reach are evaluated exactly.",
        low=1,
        high=100_000,
    )
    min_information: float = setting(
        0.005,
        "A view that is expected to bring less than this share of a full unknown view is not worth "
        "taking.",
        low=0.0,
        high=1.0,
    )
    min_rating: float = setting(
        0.0, "A view rated lower than this is not worth its cost [full views].", low=-1e6, high=1e6
    )
    max_shared: ClassVar[float] = 0.5
    """A view of whose information teammates are about to see more is left to them."""
    attempts: int = setting(
        15, "To at most so many views a motion is planned before the choice gives up.", low=1
    )
    alternatives: ClassVar[int] = 3
    """Where the route turns out longer than it looked, at most so many views are compared by the
    route that each really takes.
    """
    elsewhere: ClassVar[float] = 0.4
    """Views nearer than this to one that could not be reached are tried after all others [m]."""
    min_progress: ClassVar[float] = 0.2
    """A partial approach counts only if it leads at least so far; a shorter one would be chosen
    again and again [m].
    """
    keep_margin: ClassVar[float] = 0.2
    """The previous goal is kept unless another view is better by this share of the score."""

    def __post_init__(self) -> None:
        check_config(self)


@dataclass(frozen=True, eq=False)
class Selected:
    """What `Selection` found.

    Attributes:
        views: all that were ranked, with their reasons.
        index: of the chosen one, None where there is none.
        reach: how it is reached.
        plan: views that are meant to follow, shape (K, 4, 4).
        kept: it is the previous goal.
        tried: views to which a motion was planned.
    """

    views: list[RatedView]
    index: int | None
    reach: ReachResult | None
    plan: FloatArray
    kept: bool
    tried: tuple[int, ...]


class Approach:
    """Plans motions to views in turn until one is reached; keeps the best partial approach.

    Attributes:
        index: of the view that is chosen, None as long as there is none.
        result: the route to it.
        is_over: a view is reached, or all attempts are spent.
        tried: the views to which a motion was planned.
    """

    def __init__(
        self,
        config: SelectionConfig,
        options: Options,
        cost: Cost,
        reachability: Reachability,
        compares: bool,
    ) -> None:
        """Set up.

        Args:
            config: limits.
            options: the views.
            cost: what a route costs.
            reachability: plans the motions.
            compares: whether scores count in full views, so that costs of routes can be taken off.
        """
        self.index: int | None = None
        self.result: ReachResult | None = None
        self.is_over = False
        self.tried: list[int] = []
        self._config, self._options, self._cost = config, options, cost
        self._reachability, self._compares = reachability, compares

    def try_in_turn(self, views: list[RatedView], order: list[int], first_wins: bool) -> None:
        """Plan to views, best first.

        A route that is longer than it looked lowers the score; the next views are then tried too,
        as long as they may still turn out better.

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
        reason = result.reason or "the route does not lead all the way"
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
        """What the route really costs beyond what the rating has assumed [full views]."""
        assumed = view.terms.get(self._cost.term.name, np.nan)
        return self._cost.surcharge(result, assumed, float(self._options.path_lengths[index]))


class Selection:
    """One run through the second half of Fig. 7: rank, test, rank again, plan motions."""

    def __init__(
        self,
        config: SelectionConfig,
        rating: Rating,
        strategy: Strategy,
        options: Options,
        reachability: Reachability,
        known_unreachable: KnownUnreachable | None,
        watch: Stopwatch,
    ) -> None:
        """Take what decides, and the views with the information that a first ranking needs."""
        self._config, self._rating, self._strategy = config, rating, strategy
        self._options, self._reachability = options, reachability
        self._known_unreachable, self._watch = known_unreachable, watch

    def run(self) -> Selected:
        """Rank all, keep those that may be reached, rank these exactly, plan motions."""
        with self._watch.stage("rating"):
            ratings, scores = self._rank(self._options)
            views = _views(self._options, ratings, scores)
            self._reject_worthless(views, ratings, np.arange(len(views)))
        approach = Approach(
            self._config,
            self._options,
            ratings.cost,
            self._reachability,
            self._strategy.requires_positive_utility,
        )
        batches, kept = self._survivors(views, scores), False
        plans: dict[int, tuple[int, ...]] = {}
        while not approach.is_over:
            with self._watch.stage("may_reach"):
                survivors = next(batches, None)
            if survivors is None:
                break
            with self._watch.stage("refinement"):
                order, plans, kept = self._refine(views, survivors)
            with self._watch.stage("reach"):
                approach.try_in_turn(views, order, kept)
        index = approach.index
        followers = [] if index is None else list(plans.get(index, ()))
        kept = kept and index == self._options.previous
        poses = self._options.poses[followers]
        return Selected(views, index, approach.result, poses, kept, tuple(approach.tried))

    def _rank(self, options: Options) -> tuple[Ratings, Scores]:
        ratings = self._rating.rate(options)
        return ratings, self._strategy.score(options, ratings)

    def _reject_worthless(
        self, views: list[RatedView], ratings: Ratings, indices: IntArray
    ) -> None:
        """Reject what brings too little or is not worth its cost, if the strategy cares."""
        if not self._strategy.requires_positive_utility:
            return
        least = self._config.min_information
        for index, share, rating in zip(indices, ratings.shares, ratings.ratings, strict=True):
            if share < least:
                views[index] = views[index].rejected("too little information")
            elif rating < self._config.min_rating:
                views[index] = views[index].rejected("not worth its cost")

    def _leave_to_teammates(
        self, views: list[RatedView], options: Options, indices: IntArray
    ) -> None:
        """Reject what teammates are about to see themselves."""
        if options.claimed is None:
            return
        for index, left in zip(indices, options.left, strict=True):
            if 1.0 - left > self._config.max_shared and not views[index].rejection:
                views[index] = views[index].rejected(LEFT_TO_TEAMMATE)

    def _survivors(self, views: list[RatedView], scores: Scores) -> Iterator[IntArray]:
        """The views that nothing cheap speaks against, best first, as many as are refined at once.

        Asks the robot for many at once. The previous goal is among the first.
        """
        order = np.argsort(-scores.values, kind="stable")
        order = np.array([i for i in order if not views[i].rejection], np.int64)
        found = self._previous(views)
        batch = max(4 * self._config.refined, 64)
        for start in range(0, len(order), batch):
            part = [int(i) for i in order[start : start + batch] if i not in found]
            found += self._passed(views, np.array(part, np.int64))
            while len(found) >= self._config.refined:
                yield np.array(found[: self._config.refined], np.int64)
                found = found[self._config.refined :]
        if found:
            yield np.array(found, np.int64)

    def _previous(self, views: list[RatedView]) -> list[int]:
        previous = self._options.previous
        if previous is None or views[previous].rejection:
            return []
        return self._passed(views, np.array([previous]))

    def _passed(self, views: list[RatedView], indices: IntArray) -> list[int]:
        """Which views are not known to be unreachable and may be reached."""
        self._ask(views, indices, self._known_unreachable)
        left = np.array([i for i in indices if not views[i].rejection], np.int64)
        self._ask(views, left, self._reachability.may_reach)
        return [int(i) for i in left if not views[i].rejection]

    def _ask(
        self, views: list[RatedView], indices: IntArray, question: KnownUnreachable | None
    ) -> None:
        """Reject the views against which a batched question has a reason."""
        if question is None or not len(indices):
            return
        reasons = question(self._options.poses[indices])
        if len(reasons) != len(indices):
            problem = f"{len(reasons)} answers to {len(indices)} views"
            raise InvalidInputError("reachability", problem)
        for index, reason in zip(indices, reasons, strict=True):
            if reason:
                views[index] = views[index].rejected(reason)

    def _refine(
        self, views: list[RatedView], chosen: IntArray
    ) -> tuple[list[int], dict[int, tuple[int, ...]], bool]:
        """Rank the survivors by exact information; the previous goal first if it is to be kept."""
        if not len(chosen):
            return [], {}, False
        options = self._options
        exact = options.source.exact(options.situation, options.poses[chosen])
        options = options.refined(chosen, exact)
        ratings, scores = self._rank(options)
        for index, view in zip(chosen, _views(options, ratings, scores), strict=True):
            views[index] = view
        self._reject_worthless(views, ratings, chosen)
        self._leave_to_teammates(views, options, chosen)
        order = np.argsort(-scores.values, kind="stable")
        ranked = [int(chosen[i]) for i in order if not views[chosen[i]].rejection]
        kept = self._keeps(views, ranked)
        if kept:
            assert self._options.previous is not None
            ranked.remove(self._options.previous)
            ranked.insert(0, self._options.previous)
        plans = {
            int(chosen[first]): tuple(int(chosen[i]) for i in others)
            for first, others in scores.plans.items()
        }
        return ranked, plans, kept

    def _keeps(self, views: list[RatedView], ranked: list[int]) -> bool:
        """Whether the previous goal goes first although others score higher, or highest anyway."""
        previous = self._options.previous
        if previous is None or previous not in ranked:
            return False
        best, own = views[ranked[0]].score, views[previous].score
        return best - own <= self._config.keep_margin * max(abs(best), abs(own))


def _views(options: Options, ratings: Ratings, scores: Scores) -> list[RatedView]:
    names = list(ratings.terms)
    columns = np.stack([ratings.terms[name] for name in names], axis=1).tolist()
    rows = zip(
        options.poses, columns, ratings.ratings.tolist(), scores.values.tolist(), strict=True
    )
    return [
        RatedView(pose, dict(zip(names, values, strict=True)), rating, score, fine=options.fine)
        for pose, values, rating, score in rows
    ]
