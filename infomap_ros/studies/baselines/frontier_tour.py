"""A tour of all frontiers, planned again after every view.

After B. Zhou, Y. Zhang, X. Chen, S. Shen, "FUEL: Fast UAV Exploration Using Incremental Frontier
Structure and Hierarchical Planning", RA-L 6(2), 2021, doi:10.1109/LRA.2021.3051563, sections V.B to
V.C: clusters of frontiers, views that cover them, a tour, refined views at its beginning. Without
the trajectories, as the sensor has no dynamics here.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.studies.baselines.frontiers import (
    Frontier,
    find_frontiers,
    level_views,
    places_of,
    scores_of,
    shares_of,
)
from infomap_ros.views.ranking.options import Options
from infomap_ros.views.ranking.rating import Ratings
from infomap_ros.views.ranking.strategy import Scores
from infomap_ros.views.sampling import coarse_views
from infomap_ros.views.sampling.surroundings import Surroundings
from infomap_ros.views.situation import Situation

_LARGEST = 0.35  # a cluster extends so far from its mean [ranges]
_RINGS = (0.0, 0.25, 0.5, 0.75)  # distances of views from a cluster [ranges]
_AZIMUTHS = 12
_VIEWS = 3  # per cluster
_LEAST_COVERED = 0.5  # of what the best view of a cluster covers
_NOTHING = 0.002  # a view that informs less covers nothing [full views]
_REFINED = 4  # clusters whose views are chosen together


class FrontierTour:
    """Heads for the first view of the shortest tour through views of all frontiers."""

    requires_positive_utility = False

    def __init__(self) -> None:
        self._proposed = np.empty((0, 4, 4))
        self._cluster = np.empty(0, np.int64)
        self._values = np.empty(0)

    def propose(
        self, situation: Situation, surroundings: Surroundings, rng: np.random.Generator
    ) -> FloatArray:
        """The views of every cluster that cover most of it."""
        largest = _LARGEST * situation.max_range
        views = [
            _covering_views(frontier, situation, surroundings)
            for frontier in find_frontiers(situation, surroundings, largest=largest)
        ]
        self._cluster = np.repeat(np.arange(len(views)), [len(part) for part in views])
        self._proposed = np.concatenate([np.empty((0, 4, 4)), *views])
        return self._proposed

    def score(self, options: Options, ratings: Ratings) -> Scores:
        """Minus the place in the tour; further views of a cluster after all others."""
        places = places_of(options, self._proposed)
        if not options.fine:
            self._values = self._plan(options, ratings, places)
        return Scores(scores_of(options, places, self._values, ratings.ratings))

    def _plan(self, options: Options, ratings: Ratings, places: NDArray[np.int64]) -> FloatArray:
        """Values of the proposed views, shape (N,); views taken in vain are left out."""
        useful = shares_of(options, ratings, places) > _NOTHING
        lengths = np.where(useful, options.path_lengths[places], np.inf)
        values = -1e6 - np.minimum(lengths, 1e6)
        usable = np.isfinite(lengths)
        first_of = [
            int(np.flatnonzero(usable & (self._cluster == cluster))[0])
            for cluster in np.unique(self._cluster[usable])
        ]
        if not first_of:
            return np.asarray(values)
        stops = np.array(first_of)
        order = stops[open_tour(lengths[stops], self._distances(options, stops))]
        refined = self._refined(options, order[:_REFINED], usable, lengths)
        for turn, view in enumerate([*refined, *order[_REFINED:]]):
            values[view] = -float(turn)
        return np.asarray(values)

    def _distances(self, options: Options, views: NDArray[np.int64]) -> FloatArray:
        """Distances between proposed views, shape (n, n) [m]."""
        spots = self._proposed[views, :3, 3]
        rows = [options.surroundings.path_lengths_from(spot, spots) for spot in spots]
        distances = np.array(rows).reshape(len(spots), len(spots))
        return np.asarray(np.minimum(distances, distances.T))

    def _refined(
        self,
        options: Options,
        order: NDArray[np.int64],
        usable: NDArray[np.bool_],
        lengths: FloatArray,
    ) -> list[int]:
        """The views of the first clusters that make the path through them shortest."""
        layers = [np.flatnonzero(usable & (self._cluster == self._cluster[stop])) for stop in order]
        nodes = np.concatenate(layers)
        distances = self._distances(options, nodes)
        starts = np.cumsum([0, *(len(layer) for layer in layers)])
        cost, back = lengths[layers[0]], []
        for turn in range(1, len(layers)):
            before = slice(starts[turn - 1], starts[turn])
            here = slice(starts[turn], starts[turn + 1])
            total = cost[:, None] + distances[before, here]
            back.append(total.argmin(axis=0))
            cost = total.min(axis=0)
        chosen = [int(cost.argmin())]
        for step in reversed(back):
            chosen.append(int(step[chosen[-1]]))
        chosen.reverse()
        return [int(layer[index]) for layer, index in zip(layers, chosen, strict=True)]


def _covering_views(
    frontier: Frontier, situation: Situation, surroundings: Surroundings
) -> FloatArray:
    """The views around a cluster that hold most of its cells, best first, shape (<= 3, 4, 4)."""
    spots = _spots(frontier, situation, surroundings)
    covered, azimuths = np.zeros(len(spots)), np.zeros(len(spots))
    half = 0.5 * situation.camera.field_of_view[0]
    for index, spot in enumerate(spots):
        offsets = frontier.places - spot
        gaps = np.linalg.norm(offsets, axis=1)
        seen = _in_sight(surroundings, spot, frontier.places)
        seen &= gaps <= situation.max_range
        towards = frontier.middle - spot
        if gaps.min() < surroundings.voxel_size:
            towards = _outward(frontier, surroundings, spot)
        azimuths[index] = np.arctan2(towards[1], towards[0])
        turn = np.arctan2(offsets[:, 1], offsets[:, 0]) - azimuths[index]
        seen &= np.abs(np.remainder(turn + np.pi, 2.0 * np.pi) - np.pi) <= half
        covered[index] = np.count_nonzero(seen)
    best = np.argsort(-covered, kind="stable")[:_VIEWS]
    best = best[covered[best] >= _LEAST_COVERED * covered[best[0]]]
    return level_views(spots[best], azimuths[best])


def _spots(frontier: Frontier, situation: Situation, surroundings: Surroundings) -> FloatArray:
    """Places around a cluster that can be reached; its center at least, shape (n, 3)."""
    angles = 2.0 * np.pi * np.arange(_AZIMUTHS) / _AZIMUTHS
    around = np.column_stack([np.cos(angles), np.sin(angles), np.zeros(_AZIMUTHS)])
    rings = [frontier.center + ring * situation.max_range * around for ring in _RINGS[1:]]
    size = surroundings.voxel_size
    spots = (np.floor(np.concatenate(rings) / size) + 0.5) * size
    places, inside = surroundings.in_box(spots)
    inside[inside] = surroundings.reached[tuple(places[inside].T)]
    return np.concatenate([frontier.center[None], spots[inside]])


def _in_sight(
    surroundings: Surroundings, spot: FloatArray, targets: FloatArray
) -> NDArray[np.bool_]:
    seen = np.empty(len(targets), np.bool_)
    origin = spot / surroundings.voxel_size - surroundings.window.first
    places = surroundings.window.positions_of(targets)
    coarse_views.mark_in_sight(surroundings.states, origin, places, seen)
    return seen


def _outward(frontier: Frontier, surroundings: Surroundings, spot: FloatArray) -> FloatArray:
    """Direction from a frontier cell towards the unknown beside it, shape (3,)."""
    size = surroundings.voxel_size
    sides = np.array([(1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0)], np.float64)
    beside = (frontier.places[:, None] + sides * size).reshape(-1, 3)
    unknown = surroundings.states_at(beside) == 0
    weights = np.exp(-np.linalg.norm(beside - spot, axis=1) / (4.0 * size)) * unknown
    return np.asarray((weights[:, None] * np.tile(sides, (len(frontier.places), 1))).sum(axis=0))


_FAR = 1e6  # stands for no path [m]


def open_tour(first: FloatArray, between: FloatArray) -> NDArray[np.int64]:
    """An order in which to visit places, from a start and without coming back.

    Nearest place first, improved by reversing parts (2-opt) and by moving single places (Or-opt)
    until neither shortens the tour: G. A. Croes 1958, doi:10.1287/opre.6.6.791.

    Args:
        first: distances from the start, shape (n,) [m]; inf where there is none.
        between: distances between the places, shape (n, n) [m], symmetric.

    Returns:
        The order, shape (n,).
    """
    count = len(first)
    distances = np.full((count + 1, count + 1), 0.0)
    distances[0, 1:] = np.minimum(first, _FAR)
    distances[1:, 1:] = np.minimum(between, _FAR)
    left, order = set(range(1, count + 1)), [0]
    while left:
        here = distances[order[-1]]
        order.append(min(left, key=lambda place: float(here[place])))
        left.remove(order[-1])
    improved = True
    while improved:
        improved = _reverse_once(order, distances) or _move_once(order, distances)
    return np.array(order[1:], np.int64) - 1


def tour_length(order: NDArray[np.int64], first: FloatArray, between: FloatArray) -> float:
    """Length of an order of visit [m]."""
    if not len(order):
        return 0.0
    return float(first[order[0]] + between[order[:-1], order[1:]].sum())


def _reverse_once(order: list[int], distances: FloatArray) -> bool:
    """Reverse the part that shortens the tour most, if any does."""
    best, where = -1e-9, (0, 0)
    path = np.array(order)
    for i in range(1, len(path) - 1):
        ends = path[i + 1 :]
        before = distances[path[i - 1], path[i]]
        change = distances[path[i - 1], ends] - before
        change[:-1] += distances[path[i], ends[1:]] - distances[ends[:-1], ends[1:]]
        j = int(change.argmin())
        if change[j] < best:
            best, where = float(change[j]), (i, i + 1 + j)
    i, j = where
    if j:
        order[i : j + 1] = order[i : j + 1][::-1]
    return bool(j)


def _move_once(order: list[int], distances: FloatArray) -> bool:
    """Move one place to where it costs least, if that shortens the tour."""
    path = np.array(order)
    for i in range(1, len(path)):
        place = path[i]
        rest = np.delete(path, i)
        saved = distances[path[i - 1], place]
        if i + 1 < len(path):
            saved += distances[place, path[i + 1]] - distances[path[i - 1], path[i + 1]]
        cost = distances[rest, place].copy()
        cost[:-1] += distances[place, rest[1:]] - distances[rest[:-1], rest[1:]]
        at = int(cost.argmin())
        if cost[at] < saved - 1e-9 and at != i - 1:
            order[:] = [*rest[: at + 1], place, *rest[at + 1 :]]
            return True
    return False
