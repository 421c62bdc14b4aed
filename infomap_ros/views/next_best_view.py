"""The choice of the next view: Fig. 7 of Sujan and Dubowsky 2005 as code."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.views.decision import (
    RatedView,
    Reachability,
    Stopwatch,
    ViewDecision,
    why_none,
    why_this,
)
from infomap_ros.views.information.view_information import ExpectedInformation
from infomap_ros.views.ranking.look_ahead import LookAheadConfig
from infomap_ros.views.ranking.options import InformationSource, Options
from infomap_ros.views.ranking.rating import Rating, RatingConfig
from infomap_ros.views.ranking.strategies import make_strategy
from infomap_ros.views.ranking.strategy import ProposesViews, Strategy
from infomap_ros.views.ranking.terms import LocalizationError, RatingTerm
from infomap_ros.views.sampling.candidates import CandidateConfig, Candidates, find_candidates
from infomap_ros.views.sampling.orientations import OrientationConfig
from infomap_ros.views.sampling.surroundings import (
    Surroundings,
    SurroundingsConfig,
    horizons,
    survey,
)
from infomap_ros.views.selection import KnownUnreachable, Selected, Selection, SelectionConfig
from infomap_ros.views.situation import Situation


@dataclass(frozen=True)
class NextBestViewConfig:
    """Configuration of `NextBestView`: those of its parts."""

    surroundings: SurroundingsConfig = field(default_factory=SurroundingsConfig)
    candidates: CandidateConfig = field(default_factory=CandidateConfig)
    orientations: OrientationConfig = field(default_factory=OrientationConfig)
    rating: RatingConfig = field(default_factory=RatingConfig)
    selection: SelectionConfig = field(default_factory=SelectionConfig)
    look_ahead: LookAheadConfig = field(default_factory=LookAheadConfig)


class NextBestView:
    """Chooses where to look next, and says why."""

    def __init__(
        self,
        config: NextBestViewConfig | None = None,
        strategy: str | Strategy = "largest_information",
        information: InformationSource | None = None,
        localization_error: LocalizationError | None = None,
        more_terms: Sequence[tuple[RatingTerm, float]] = (),
    ) -> None:
        """Set the choice up.

        Args:
            config: of all stages.
            strategy: name of a strategy, or the dotted path of a class, see `make_strategy`; or a
                strategy itself.
            information: what views are expected to tell; expected entropy reduction by default.
            localization_error: model of LE of eq. (11); odometry drift by default.
            more_terms: further terms of the rating with their weights; see `Rating`.

        Raises:
            ConfigError: there is no such strategy.
        """
        self.config = config or NextBestViewConfig()
        if isinstance(strategy, str):
            self.strategy_name = strategy
            self._strategy = make_strategy(strategy, self.config.look_ahead)
        else:
            self.strategy_name, self._strategy = type(strategy).__name__, strategy
        self._information = information or ExpectedInformation()
        radius = self.config.surroundings.camera_radius
        self._rating = Rating(self.config.rating, radius, localization_error, more_terms)

    def select(
        self,
        situation: Situation,
        reachability: Reachability,
        rng: np.random.Generator,
        previous_goal: FloatArray | None = None,
        known_unreachable: KnownUnreachable | None = None,
    ) -> ViewDecision:
        """Choose the next view.

        Args:
            situation: what is known.
            reachability: the robot, asked for the views that passed all cheaper tests.
            rng: draws candidates.
            previous_goal: ``T_map_camera`` that the robot is heading for, shape (4, 4).
            known_unreachable: reasons not to try views, such as those of a `GoalMemory`.

        Returns:
            The choice with every candidate, its terms, and every reason.
        """
        watch, considered = Stopwatch(), list[RatedView]()
        for settings in horizons(situation, self.config.surroundings):
            with watch.stage("surroundings"):
                surroundings = survey(situation, settings)
            with watch.stage("candidates"):
                candidates = self._candidates(situation, surroundings, rng, previous_goal)
            with watch.stage("information"):
                options = self._appraise(situation, surroundings, candidates, rng, previous_goal)
            selected = Selection(
                self.config.selection,
                self._rating,
                self._strategy,
                options,
                reachability,
                known_unreachable,
                watch,
            ).run()
            considered = [*selected.views, *_ruled_out(candidates), *considered]
            if selected.index is not None or surroundings.is_whole or self._gives_up(selected):
                break
        return self._explain(selected, options, considered, watch)

    def _candidates(
        self,
        situation: Situation,
        surroundings: Surroundings,
        rng: np.random.Generator,
        previous_goal: FloatArray | None,
    ) -> Candidates:
        goal = np.empty((0, 4, 4)) if previous_goal is None else np.array([previous_goal])
        own = np.empty((0, 4, 4))
        if isinstance(self._strategy, ProposesViews):
            own = self._strategy.propose(situation, surroundings, rng)
        extra = np.concatenate([situation.arm_views, own, goal])
        settings = self.config
        return find_candidates(
            situation, surroundings, rng, settings.candidates, settings.orientations, extra
        )

    def _appraise(
        self,
        situation: Situation,
        surroundings: Surroundings,
        candidates: Candidates,
        rng: np.random.Generator,
        previous_goal: FloatArray | None,
    ) -> Options:
        """All candidates with the information that is good enough for a first ranking."""
        source = self._information
        quick = source.quick(situation, candidates.positions, candidates.orientations)
        extra = source.quick(
            situation, candidates.extra[:, :3, 3], candidates.extra[:, None, :3, :3]
        )
        information = np.concatenate([quick.ravel(), extra.ravel()])
        full_view = source.full_view(situation)
        if full_view <= 0.0:  # unknown space tells this metric nothing: compare with the best
            full_view = max(float(information.max(initial=0.0)), 1e-12)
        return Options(
            situation,
            surroundings,
            candidates.poses,
            information,
            full_view,
            source,
            rng,
            previous=_place_of(previous_goal, candidates),
        )

    def _gives_up(self, selected: Selected) -> bool:
        """Whether as many motions were planned as may be."""
        return len(selected.tried) >= self.config.selection.attempts

    def _explain(
        self, selected: Selected, options: Options, considered: list[RatedView], watch: Stopwatch
    ) -> ViewDecision:
        """The decision with every candidate and the reason in words."""
        chosen = None if selected.index is None else selected.views[selected.index]
        if chosen is None:
            reason = why_none(considered)
            if self._gives_up(selected):
                reason += " As many motions failed as are tried at most; other views were not."
            if not options.surroundings.is_whole:
                reason += " What lies farther away was not searched."
        else:
            source = options.source
            full_view = source.full_view(options.situation)
            reason = why_this(chosen, considered, selected.kept, full_view, source.unit)
        return ViewDecision(
            chosen,
            selected.reach,
            tuple(considered),
            f"{self.strategy_name}: {reason}",
            watch.seconds,
            selected.plan,
            self.strategy_name,
        )


def _ruled_out(candidates: Candidates) -> list[RatedView]:
    """The positions that a cheap test has ruled out, with the reason."""
    pairs = zip(candidates.rejected, candidates.reasons, strict=True)
    return [RatedView(pose, rejection=reason) for pose, reason in pairs]


def _place_of(goal: FloatArray | None, candidates: Candidates) -> int | None:
    """Where the previous goal is among all that passed: the last, unless it was ruled out."""
    if goal is None or not len(candidates.extra):
        return None
    is_last = bool(np.array_equal(candidates.extra[-1], goal))
    return len(candidates.poses) - 1 if is_last else None
