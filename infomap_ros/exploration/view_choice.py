"""The choice among candidates, again with others, by missing surface, and from afar at last."""

from __future__ import annotations

from copy import deepcopy
from dataclasses import replace
from functools import partial

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import ndimage

from infomap_ros.exploration.progress import GOES_ON, faces, start_in
from infomap_ros.exploration.view_planner_config import ViewPlannerConfig
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.mapping import LOG_ODDS_QUANTUM, VoxelMap, VoxelMapConfig
from infomap_ros.mapping.voxels.window import UNKNOWN_QUANTA
from infomap_ros.motion.reaching import WholeBodyReach
from infomap_ros.motion.route import ReachResult
from infomap_ros.views.decision import GoalMemory, ViewDecision
from infomap_ros.views.information.field import (
    VisibleField,
    visible_field,
    with_nothing_unknown_but,
)
from infomap_ros.views.information.gains import code_book, expected_reduction
from infomap_ros.views.information.view_information import ExpectedInformation, bits_in
from infomap_ros.views.information.view_query import InformationConfig, ViewQuery
from infomap_ros.views.next_best_view import NextBestView, NextBestViewConfig
from infomap_ros.views.ranking.options import InformationSource, Options, claimed_gains, shares_left
from infomap_ros.views.ranking.rating import Ratings
from infomap_ros.views.ranking.strategy import Scores
from infomap_ros.views.ranking.terms import LocalizationError
from infomap_ros.views.sampling.orientations import look_rotations
from infomap_ros.views.sampling.surroundings import Surroundings
from infomap_ros.views.situation import Situation


class ViewChoice:
    """Chooses a view that can be reached and is worth its cost.

    Where none of the views that were tried can be reached, they are remembered and others are
    drawn. Where none is worth its cost although more is asked for, views are sought that close the
    holes of the mapped surface; where there is none either, the distance counts less.

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
            robot: asked for routes to views.
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
        sources: tuple[InformationSource, ...] = (self._information, self._completion)
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
    """A choice for which the distance, and what localization suffers on it, count by a share."""
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


_PROPOSED = 600  # views that are proposed
_NEAREST, _FARTHEST = 0.5, 2.2  # [m] from which they look
_CONE = 0.9  # [rad] about the normal within which they stand
_ELEVATION = 1.2  # [rad], steepest glance of theirs


class SurfaceCompletion(ExpectedInformation):
    """What views show of the missing surface, and views that would show much of it.

    The information of eq. (11) counts what views tell about volume. A strip of floor behind a
    table, or the underside of its top, is a sheet one voxel thick: a hundredth of what a view into
    open unknown space tells, not worth a meter of travel by that measure, while the task asks for
    surface. Here a view counts the voxels of missing surface that it is expected to show, and a
    full view is one that shows nothing but missing surface from half the camera's range.

    The `InformationSource` for which nothing is unknown but the missing surface, as a `Strategy`
    that proposes views.

    Args:
        sensor: what the camera tells from afar.
        threads: that share the rays.
    """

    requires_positive_utility = True

    def __init__(self, sensor: InformationConfig, threads: int = 2) -> None:
        only = replace(sensor, known_weight=0.0, wanted_sigma=0.0, predict_unknown=False)
        super().__init__(config=only, threads=threads)
        self.unit = "voxels of missing surface"
        self._voxels: NDArray[np.int64] = np.empty((0, 3), np.int64)
        self._places: FloatArray = np.empty((0, 3))
        self._normals: FloatArray = np.empty((0, 3))

    def prepare(self, situation: Situation) -> int:
        """Find what is missing; returns how much of it is not given up."""
        region = np.stack([situation.region.low, situation.region.high])
        voxels, normals = missing_surface(situation.voxel_map, region, situation.position)
        places = np.asarray((voxels + 0.5) * situation.voxel_map.config.voxel_size, np.float64)
        left = ~situation.promising_map.is_known(places)
        self._voxels, self._places, self._normals = voxels[left], places[left], normals[left]
        return int(left.sum())

    def full_view(self, situation: Situation) -> float:
        """Voxels of a wall that fills the image, half the camera's range away."""
        camera, size = situation.camera, situation.voxel_map.config.voxel_size
        distance = 0.5 * situation.max_range
        area = (camera.width / camera.fx) * (camera.height / camera.fy) * distance**2
        return float(area / size**2)

    def score(self, options: Options, ratings: Ratings) -> Scores:
        """The rating of eq. (11), with the missing surface for the information."""
        return Scores(ratings.ratings)

    def propose(
        self, situation: Situation, surroundings: Surroundings, rng: np.random.Generator
    ) -> FloatArray:
        """Views of missing places, each from somewhere before it, shape (E, 4, 4)."""
        if not len(self._places):
            return np.empty((0, 4, 4))
        about = rng.integers(len(self._places), size=_PROPOSED)
        offsets = _within_cone(self._normals[about], rng)
        offsets *= rng.uniform(_NEAREST, _FARTHEST, (_PROPOSED, 1))
        poses = np.tile(np.eye(4), (_PROPOSED, 1, 1))
        poses[:, :3, 3] = self._places[about] + offsets
        elevations = np.arctan2(-offsets[:, 2], np.hypot(offsets[:, 0], offsets[:, 1]))
        elevations = np.clip(elevations, -_ELEVATION, _ELEVATION)
        azimuths = np.arctan2(-offsets[:, 1], -offsets[:, 0])
        poses[:, :3, :3] = look_rotations(azimuths, elevations)
        _, inside = surroundings.in_box(poses[:, :3, 3])
        return np.asarray(poses[inside])

    def _evaluate(
        self, situation: Situation, poses: FloatArray, config: InformationConfig
    ) -> FloatArray:
        """Voxels of missing surface that views, (M, 4, 4), show: (M,)."""
        if not len(poses):
            return np.zeros(0)
        query = ViewQuery(
            situation.voxel_map,
            np.ascontiguousarray(poses),
            situation.camera,
            situation.max_range,
            config,
            self._region(situation),
            self._threads,
        )
        bits = bits_in(self._field_about(situation, poses), query)
        return np.asarray(bits / _bits_of_a_voxel(situation.voxel_map.config))

    def _field_about(self, situation: Situation, poses: FloatArray) -> VisibleField:
        places, reach, book = poses[:, :3, 3], situation.max_range, code_book(self.config)
        low, high = places.min(axis=0) - reach, places.max(axis=0) + reach
        field = visible_field(situation.voxel_map, low, high, book, self._threads)
        return with_nothing_unknown_but(field, self._voxels)

    @staticmethod
    def _region(situation: Situation) -> FloatArray:
        """What of the region the map holds: rays take all beyond it for unknown."""
        size, bounds = situation.voxel_map.config.voxel_size, situation.voxel_map.bounds()
        low, high = situation.region.low, situation.region.high
        if bounds is not None:
            low, high = np.maximum(low, bounds[0] * size), np.minimum(high, (bounds[1] + 1) * size)
        return np.stack([low, np.maximum(low, high)])


def missing_surface(
    voxel_map: VoxelMap, region: ArrayLike, inside: ArrayLike
) -> tuple[NDArray[np.int64], FloatArray]:
    """The holes of the surface, in which `measure_progress` misses some of it.

    Args:
        voxel_map: the map.
        region: box (low, high), shape (2, 3), map frame [m].
        inside: a point of the free space about the robot, shape (3,) [m].

    Returns:
        Indices of the voxels in the map, shape (N, 3), and unit vectors from them to the free space
        that they border on, shape (N, 3).
    """
    window = voxel_map.window(*np.asarray(region, dtype=np.float64))
    states, directions = window.states(), list[FloatArray]()
    unseen = window.quanta == UNKNOWN_QUANTA
    places = [np.empty((0, 3), np.int64)]
    for direction, _, missing in faces(states, start_in(window, states, inside)):
        about = np.where(direction == 0.0, 2 * GOES_ON - 1, 1)
        places.append(np.argwhere(unseen & ndimage.maximum_filter(missing, about)))
        directions.append(np.tile(direction, (len(places[-1]), 1)))
    voxels, at = np.unique(np.concatenate(places), axis=0, return_inverse=True)
    normals = np.zeros((len(voxels), 3))
    np.add.at(normals, np.ravel(at), np.concatenate(directions))
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1.0)
    return voxels + window.first, normals


def _bits_of_a_voxel(grid: VoxelMapConfig) -> float:
    """What one observation from next to it tells of an unknown voxel [bits]."""
    hit, miss = grid.hit_quanta * LOG_ODDS_QUANTUM, grid.miss_quanta * LOG_ODDS_QUANTUM
    return float(expected_reduction(0.5, hit, miss))


def _within_cone(axes: FloatArray, rng: np.random.Generator) -> FloatArray:
    """Unit vectors within `_CONE` of unit vectors, shape (N, 3)."""
    offsets = rng.standard_normal(axes.shape)
    offsets -= (offsets * axes).sum(axis=1, keepdims=True) * axes
    offsets /= np.maximum(np.linalg.norm(offsets, axis=1, keepdims=True), 1e-9)
    angles = _CONE * np.sqrt(rng.random((len(axes), 1)))
    return np.asarray(np.cos(angles) * axes + np.sin(angles) * offsets)
