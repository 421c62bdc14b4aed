"""More than one view ahead: sequences of views that share no information."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from infomap_ros.geometry.config import check_config, parameter
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.mapping.scans.traversal import unpack_all
from infomap_ros.views.options import Options
from infomap_ros.views.rating import Ratings
from infomap_ros.views.strategy import Scores
from infomap_ros.views.surroundings import IntArray
from infomap_ros.views.terms import Distance


@dataclass(frozen=True)
class LookAheadConfig:
    """Configuration of `LookAhead`.

    Raises:
        ConfigError: a value is out of its range.
    """

    depth: int = parameter(3, "Number of views of a sequence.", low=1, high=10)
    views: int = parameter(
        14, "The best so many views, unlike each other, may be part of one.", low=1, high=200
    )
    beam: int = parameter(
        6, "So many of the best sequences of each length are continued.", low=1, high=1000
    )
    patience: float = parameter(
        10.0,
        "Information that comes after a way of this distance (eq. 10) counts 1/e of what comes at "
        "once.",
        low=0.01,
        high=1e6,
    )
    cost_of_view: float = parameter(
        2.0, "A view costs as much as a way of this distance.", low=0.0, high=1e6
    )
    unlike_distance: float = parameter(
        0.7, "Views are alike that are nearer to each other than this, and", unit="m", low=0.0
    )
    unlike_angle: float = parameter(
        0.5, "whose optical axes differ by less than this.", unit="rad", low=0.0, high=3.15
    )

    def __post_init__(self) -> None:
        check_config(self)


class LookAhead:
    """Ranks a view by the best sequence of views that starts with it.

    The worth of a sequence is the sum over its views of the rating of eq. (11) with the information
    that the views before do not already bring, and the distance from the view before. What comes
    late counts less, by ``exp(-D / patience)``, D the distance of eq. (10) covered until then, each
    view included; so a small gain on the way to a large one is taken first, and one off the way is
    not. Discounting by distance is that of Gonzalez-Banos and Latombe (2002,
    doi:10.1177/0278364902021010834), there for one view.
    """

    needs_worth = True

    def __init__(self, config: LookAheadConfig | None = None) -> None:
        self.config = config or LookAheadConfig()

    def score(self, options: Options, ratings: Ratings) -> Scores:
        """Worth of the best sequence that starts with each view [full views, discounted].

        In the first ranking: the ratings, views that are like a better one after all others.
        """
        if not options.fine:
            return Scores(self._apart(options, ratings.ratings))
        near = np.exp(-self._way(ratings.terms["distance"]) / self.config.patience)
        alone = np.where(ratings.ratings > 0.0, ratings.ratings * near, ratings.ratings)
        order = np.argsort(-self._apart(options, ratings.ratings), kind="stable")
        chosen = np.sort(order[: self.config.views])
        return _Search(self.config, options, ratings, alone, chosen).run()

    def _way(self, distances: FloatArray) -> FloatArray:
        return distances + self.config.cost_of_view

    def _apart(self, options: Options, ratings: FloatArray) -> FloatArray:
        """The ratings, lowered by their range for views that are like a better one."""
        positions, axes = options.positions, options.poses[:, :3, 2]
        values, spread = ratings.copy(), float(np.ptp(ratings)) + 1.0 if len(ratings) else 0.0
        open_views = np.ones(len(ratings), np.bool_)
        least_cosine = math.cos(self.config.unlike_angle)
        for best in np.argsort(-ratings, kind="stable"):
            if not open_views[best]:
                continue
            near = np.linalg.norm(positions - positions[best], axis=1) < self.config.unlike_distance
            alike = open_views & near & (axes @ axes[best] > least_cosine)
            open_views[alike] = False
            alike[best] = False
            values[alike] -= spread
        return values


class _Search:
    """A beam search over sequences of a few views."""

    def __init__(
        self,
        config: LookAheadConfig,
        options: Options,
        ratings: Ratings,
        alone: FloatArray,
        chosen: IntArray,
    ) -> None:
        self._config, self._chosen, self._alone = config, chosen, alone
        self._worth = ratings.config.information_weight * ratings.shares[chosen]
        self._cost = ratings.config.distance_weight
        self._safe = 1.0 - ratings.terms["risk"][chosen]
        self._ratings = ratings.ratings[chosen]
        self._first = ratings.terms["distance"][chosen]
        self._between = distances_between(options, ratings, chosen)
        self._places, self._gains, self._size = shared_voxels(options, chosen)

    def run(self) -> Scores:
        """Worth of every view, and the followers of those that were looked into."""
        values, plans = self._alone.copy(), {}
        beam = [self._start(view) for view in range(len(self._chosen))]
        for sequence in beam:
            values[self._chosen[sequence.views[0]]] = sequence.worth
        for _ in range(self._config.depth - 1):
            beam = [longer for sequence in beam for longer in self._longer(sequence)]
            beam = sorted(beam, key=lambda sequence: -sequence.worth)[: self._config.beam]
            for sequence in beam:
                first, *others = (int(self._chosen[view]) for view in sequence.views)
                if sequence.worth > values[first]:
                    values[first], plans[first] = sequence.worth, tuple(others)
        return Scores(values, plans)

    def _start(self, view: int) -> _Sequence:
        way = float(self._first[view]) + self._config.cost_of_view
        rating = float(self._ratings[view])
        return _Sequence((view,), rating * self._discount(way, rating), way)

    def _longer(self, sequence: _Sequence) -> list[_Sequence]:
        """The sequence continued with every other view."""
        told = np.zeros(self._size)
        for view in sequence.views:
            places = self._places[view]
            told[places] = np.maximum(told[places], self._gains[view])
        last, found = sequence.views[-1], []
        for view in range(len(self._chosen)):
            if view in sequence.views:
                continue
            gains, step = self._gains[view], float(self._between[last, view])
            news = np.maximum(gains - told[self._places[view]], 0.0).sum()
            share = float(news) / max(float(gains.sum()), 1e-12)
            rating = float(self._worth[view] * share - self._cost * step) * float(self._safe[view])
            way = sequence.way + step + self._config.cost_of_view
            worth = sequence.worth + rating * self._discount(way, rating)
            found.append(_Sequence((*sequence.views, view), worth, way))
        return found

    def _discount(self, way: float, rating: float) -> float:
        """Of gains; what costs more than it brings is not made better by coming late."""
        return math.exp(-way / self._config.patience) if rating > 0.0 else 1.0


@dataclass(frozen=True)
class _Sequence:
    views: tuple[int, ...]
    worth: float
    way: float


def distances_between(options: Options, ratings: Ratings, chosen: IntArray) -> FloatArray:
    """Distance of eq. (10) from each of the chosen views to each, shape (K, K)."""
    config, poses = ratings.config, options.poses[chosen]
    distance = Distance(config.position_weights, config.rotation_weights)
    rows = []
    for pose in poses:
        lengths = options.surroundings.path_lengths_from(pose[:3, 3], poses[:, :3, 3])
        rows.append(distance.between(pose, poses, lengths))
    return np.array(rows).reshape(len(poses), len(poses))


def shared_voxels(
    options: Options, chosen: IntArray
) -> tuple[list[IntArray], list[FloatArray], int]:
    """What voxels each view informs: their places in an array, and by how much.

    Returns:
        Places (K,) and gains (K,) per view, weighted by wishes, and the size of the array.
    """
    gains = options.source.gains(options.situation, options.poses[chosen])
    keys, places = np.unique(
        np.concatenate([gain.keys for gain in gains] or [np.empty(0, np.int64)]),
        return_inverse=True,
    )
    indices = np.empty((len(keys), 3), np.int64)
    unpack_all(keys, len(keys), indices)
    centres = np.asarray((indices + 0.5) * options.surroundings.voxel_size, dtype=np.float64)
    wishes = options.wishes.of(options.surroundings, centres).prod(axis=1)
    parts = np.split(np.ravel(places), np.cumsum([len(gain.keys) for gain in gains])[:-1])
    weighted = [gain.gains * wishes[part] for gain, part in zip(gains, parts, strict=True)]
    return parts, weighted, len(keys)
