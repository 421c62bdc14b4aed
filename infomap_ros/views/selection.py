"""From ranked candidates to one view: the second half of Fig. 7 of Sujan and Dubowsky 2005."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from infomap_ros.errors import InvalidInputError
from infomap_ros.geometry.config import check_config, parameter
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.views.decision import RatedView, Stopwatch
from infomap_ros.views.options import Options
from infomap_ros.views.rating import Rating, Ratings
from infomap_ros.views.reach import Reachability, ReachResult
from infomap_ros.views.strategy import Scores, Strategy
from infomap_ros.views.surroundings import IntArray

KnownUnreachable = Callable[[FloatArray], Sequence[str]]
"""Reasons not to try views again: (M, 4, 4) -> M texts, "" where nothing is known against it."""


@dataclass(frozen=True)
class SelectionConfig:
    """Configuration of `Selection`.

    Raises:
        ConfigError: a value is out of its range.
    """

    refined: int = parameter(
        40,
        "The best so many of the views that the robot may reach are evaluated exactly.",
        low=1,
        high=100_000,
    )
    reach_attempts: int = parameter(
        12, "To at most so many views a motion is planned before the choice gives up.", low=1
    )
    least_information: float = parameter(
        0.005,
        "A view that is expected to tell less than this share of a full unknown view is not worth "
        "taking.",
        low=0.0,
        high=1.0,
    )
    least_rating: float = parameter(
        0.0, "A view rated lower than this is not worth its cost [full views].", low=-1e6, high=1e6
    )
    alternatives: int = parameter(
        3,
        "Where the way turns out longer than it looked, at most so many views are compared by the "
        "way that each really takes.",
        low=1,
        high=1000,
    )
    keep_margin: float = parameter(
        0.2,
        "The previous goal is kept unless another view is better by this share of the score.",
        low=0.0,
        high=1e6,
    )

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
    """

    views: list[RatedView]
    index: int | None
    reach: ReachResult | None
    plan: FloatArray
    kept: bool


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
        with self._watch.stage("may_reach"):
            survivors = self._survivors(views, scores)
        with self._watch.stage("refinement"):
            order, plans, kept = self._refine(views, survivors)
        with self._watch.stage("reach"):
            index, result = self._plan_motions(views, order, kept)
        kept = kept and index == self._options.previous
        followers = [] if index is None else list(plans.get(index, ()))
        return Selected(views, index, result, self._options.poses[followers], kept)

    def _rank(self, options: Options) -> tuple[Ratings, Scores]:
        ratings = self._rating.rate(options)
        return ratings, self._strategy.score(options, ratings)

    def _reject_worthless(
        self, views: list[RatedView], ratings: Ratings, indices: IntArray
    ) -> None:
        """Reject what tells too little or is not worth its cost, if the strategy cares."""
        if not self._strategy.needs_worth:
            return
        least = self._config.least_information
        for index, share, rating in zip(indices, ratings.shares, ratings.ratings, strict=True):
            if share < least:
                views[index] = views[index].rejected("tells too little")
            elif rating < self._config.least_rating:
                views[index] = views[index].rejected("not worth its cost")

    def _survivors(self, views: list[RatedView], scores: Scores) -> IntArray:
        """The best views that nothing cheap speaks against; asks the robot for many at once."""
        order = np.argsort(-scores.values, kind="stable")
        order = np.array([i for i in order if not views[i].rejection], np.int64)
        found: list[int] = []
        batch = max(4 * self._config.refined, 64)
        for start in range(0, len(order), batch):
            part = order[start : start + batch]
            self._ask(views, part, self._known_unreachable)
            part = np.array([i for i in part if not views[i].rejection], np.int64)
            self._ask(views, part, self._reachability.may_reach)
            found += [int(i) for i in part if not views[i].rejection]
            if len(found) >= self._config.refined:
                break
        chosen = found[: self._config.refined]
        previous = self._options.previous
        if previous is not None and not views[previous].rejection and previous not in chosen:
            self._ask(views, np.array([previous]), self._reachability.may_reach)
            chosen += [] if views[previous].rejection else [previous]
        return np.array(chosen, np.int64)

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

    def _plan_motions(
        self, views: list[RatedView], order: list[int], kept: bool
    ) -> tuple[int | None, ReachResult | None]:
        """Plan to the best views in turn until one is reached; else the best partial approach.

        A way that is longer than it looked lowers the score; the next views are then tried too, as
        long as they may still turn out better.
        """
        best: tuple[int | None, ReachResult | None] = (None, None)
        second_best, best_score, reached = best, -np.inf, 0
        for index in order[: self._config.reach_attempts]:
            if views[index].score <= best_score or reached == self._config.alternatives:
                break
            result = self._reachability.reach(views[index].pose)
            if result.reason or result.partial:
                reason = result.reason or "the way does not lead all the way"
                views[index] = views[index].rejected(reason)
                if result.partial and second_best[0] is None:
                    second_best = index, result
                continue
            score = views[index].score - self._surcharge(index, result)
            reached += 1
            if score > best_score:
                best, best_score = (index, result), score
            if kept or not self._strategy.needs_worth:
                break
        return second_best if best[0] is None else best

    def _surcharge(self, index: int, result: ReachResult) -> float:
        """What the way really costs beyond what the rating has assumed [full views]."""
        assumed = self._options.path_lengths[index]
        weights = self._rating.config
        excess = max(result.travel - assumed, 0.0) if np.isfinite(assumed) else 0.0
        return float(weights.distance_weight * np.mean(weights.position_weights[:2]) * excess)


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
