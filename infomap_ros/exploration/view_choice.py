"""The choice among candidates, again with others, by missing surface, and from afar at last."""

from __future__ import annotations

from copy import deepcopy
from dataclasses import replace
from functools import partial

import numpy as np

from infomap_ros.exploration.surface_completion import SurfaceCompletion
from infomap_ros.exploration.view_planner_config import ViewPlannerConfig
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.motion.reaching import WholeBodyReach
from infomap_ros.motion.route import ReachResult
from infomap_ros.views.decision import ViewDecision
from infomap_ros.views.goal_memory import GoalMemory
from infomap_ros.views.information.claimed import GainsSource, claimed_gains, shares_left
from infomap_ros.views.information.view_information import ExpectedInformation
from infomap_ros.views.next_best_view import NextBestView, NextBestViewConfig
from infomap_ros.views.ranking.localization_error import LocalizationError
from infomap_ros.views.situation import Situation


class ViewChoice:
    """Chooses a view that can be reached and is worth its cost.

    Where none of the views that were tried can be reached, they are remembered and others are
    drawn. Where none is worth its cost although more is asked for, views are sought that close the
    holes of the mapped surface; where there is none either, the way counts less.

    Args:
        config: of the choice.
        information: what views are expected to tell.
        memory: of views that could not be reached.
        localization_error: model of LE of eq. (11); odometry drift where not given.
    """

    def __init__(
        self,
        config: ViewPlannerConfig,
        information: ExpectedInformation,
        memory: GoalMemory,
        localization_error: LocalizationError | None = None,
    ) -> None:
        self._rounds = config.rounds
        self._information, self._memory = information, memory
        self._completion = SurfaceCompletion(information.config, config.threads)
        self._near = NextBestView(config.choice, config.strategy, information, localization_error)
        far = _from_afar(config.choice, config.thorough)
        close, closing = _of_surface(far, config.thorough), self._completion
        self._far = NextBestView(far, config.strategy, information, localization_error)
        self._closing = NextBestView(close, closing, closing, localization_error)
        self._is_thorough = config.thorough < 1.0

    def select(
        self,
        situation: Situation,
        robot: WholeBodyReach,
        rng: np.random.Generator,
        goal: FloatArray | None = None,
        *,
        thorough: bool = False,
        lasting: bool = True,
    ) -> ViewDecision:
        """Choose the next view.

        Args:
            situation: what is known.
            robot: asked for ways to views.
            rng: draws candidates.
            goal: ``T_map_camera`` that the robot is heading for, shape (4, 4).
            thorough: where no view is worth its cost, look for missing surface, then farther.
            lasting: remember for later choices which views could not be reached.

        Returns:
            The last decision of those that were made, with the only view that was chosen.
        """
        memory = self._memory if lasting else deepcopy(self._memory)
        choices = [self._near]
        if thorough and self._is_thorough:
            choices += [self._closing, self._far]
        for choice in choices:
            if choice is self._closing and not self._completion.prepare(situation):
                continue
            decision = self._drawn_again(choice, situation, robot, rng, goal, memory)
            if decision.chosen is not None:
                break
        return decision

    def share_left(self, situation: Situation, pose: FloatArray) -> float:
        """Share that teammates leave of what a view tells, or of the missing surface it shows.

        Args:
            situation: with the teammates.
            pose: ``T_map_camera``, shape (4, 4).

        Returns:
            The smaller of the two, 0 to 1.
        """
        sources: tuple[GainsSource, ...] = (self._information, self._completion)
        return min(
            float(shares_left(source, situation, pose[None], claimed_gains(source, situation))[0])
            for source in sources
        )

    def _drawn_again(
        self,
        choice: NextBestView,
        situation: Situation,
        robot: WholeBodyReach,
        rng: np.random.Generator,
        goal: FloatArray | None,
        memory: GoalMemory,
    ) -> ViewDecision:
        """One choice, again as long as it finds but views that cannot be reached."""
        reasons_against = partial(memory.reasons_against, voxel_map=situation.voxel_map)
        for _ in range(self._rounds):
            attempts = _Attempts(robot)
            decision = choice.select(situation, attempts, rng, goal, reasons_against)
            if decision.chosen is not None or not attempts.failures:
                break
            for pose, reason in attempts.failures:
                memory.remember(pose, reason, situation.voxel_map)
        return decision


class _Attempts:
    """A robot that can be asked which views it reaches, and remembers which it does not."""

    def __init__(self, robot: WholeBodyReach) -> None:
        self.may_reach, self._robot = robot.may_reach, robot
        self.failures: list[tuple[FloatArray, str]] = []

    def reach(self, T_map_camera: FloatArray) -> ReachResult:
        result = self._robot.reach(T_map_camera)
        if result.route is None:
            self.failures.append((T_map_camera, result.reason))
        return result


def _from_afar(config: NextBestViewConfig, share: float) -> NextBestViewConfig:
    """A choice for which the way, and what localization suffers on it, count by a share."""
    rating = config.rating
    cheap = replace(
        rating,
        distance_weight=share * rating.distance_weight,
        time_weight=share * rating.time_weight,
        localization_weight=share * rating.localization_weight,
    )
    return replace(config, rating=cheap)


def _of_surface(config: NextBestViewConfig, share: float) -> NextBestViewConfig:
    """A choice by missing surface, for which the least information counts by a share.

    Looks in vain are counted voxel by voxel there, so that views are not compared for them.
    """
    least = share * config.selection.min_information
    selection = replace(config.selection, min_information=least)
    rating = replace(config.rating, repetition_weight=0.0)
    return replace(config, rating=rating, selection=selection)
