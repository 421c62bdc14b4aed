"""More than one view ahead: sequences of views that share no information."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from infomap_ros.geometry.config import check_config, setting
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.mapping.scans.traversal import unpack_all
from infomap_ros.views.ranking import look_ahead_kernels
from infomap_ros.views.ranking.options import Options
from infomap_ros.views.ranking.rating import Ratings
from infomap_ros.views.ranking.strategy import Scores
from infomap_ros.views.sampling.surroundings import IntArray, Surroundings
from infomap_ros.views.situation import Situation


@dataclass(frozen=True)
class LookAheadConfig:
    """Configuration of `LookAhead`.

    Raises:
        ConfigError: a value is out of its range.
    """

    depth: int = setting(3, "Number of views of a sequence.", low=1, high=30)
    views: int = setting(
        14, "The best so many views, unlike each other, may be part of one.", low=1, high=200
    )
    beam: int = setting(
        6, "So many of the best sequences of each length are continued.", low=1, high=1000
    )
    discount_distance: float = setting(
        10.0,
        "Information that comes after a way of this distance (eq. 10) counts 1/e of what comes at "
        "once.",
        low=0.01,
        high=1e6,
    )
    cost_of_view: float = setting(
        2.0, "A view costs as much as a way of this distance.", low=0.0, high=1e6
    )
    unlike_distance: float = setting(
        0.7, "Views are alike that are nearer to each other than this, and", unit="m", low=0.0
    )
    unlike_angle: ClassVar[float] = 0.5
    """whose optical axes differ by less than this [rad]."""

    def __post_init__(self) -> None:
        check_config(self)


class LookAhead:
    """Ranks a view by the best sequence of views that starts with it.

    The utility of a sequence is the sum over its views of the rating of eq. (11) with the
    information that the views before do not already bring, and the distance from the view before.
    What comes late counts less, by ``exp(-D / discount_distance)``, D the distance of eq. (10)
    covered until then, each view included; so a small gain on the way to a large one is taken
    first, and one off the way is not. Discounting by distance is that of Gonzalez-Banos and Latombe
    (2002, doi:10.1177/0278364902021010834), there for one view.
    """

    requires_positive_utility = True

    def __init__(self, config: LookAheadConfig | None = None) -> None:
        self.config = config or LookAheadConfig()
        self._planned = np.empty((0, 4, 4))

    def propose(
        self, situation: Situation, surroundings: Surroundings, rng: np.random.Generator
    ) -> FloatArray:
        """The rest of the last sequence, so that it goes on unless a better one is found."""
        return self._planned

    def score(self, options: Options, ratings: Ratings) -> Scores:
        """Worth of the best sequence that starts with each view [full views, discounted].

        In the first ranking: of the view alone; views that are like a better one come last.
        """
        way = ratings.ways + self._cost_of_view(ratings)
        near = np.exp(-way / self.config.discount_distance)
        alone = np.where(ratings.ratings > 0.0, ratings.ratings * near, ratings.ratings)
        apart = self._apart(options, alone)
        if not options.fine:
            return Scores(apart)
        order = np.argsort(-apart, kind="stable")
        scores = self._search(options, ratings, alone, np.sort(order[: self.config.views]))
        best = int(scores.values.argmax()) if len(options) else -1
        self._planned = options.poses[list(scores.plans.get(best, ()))]
        return scores

    def _cost_of_view(self, ratings: Ratings) -> float:
        """What a look costs, as a distance, where the cost does not hold it."""
        return 0.0 if ratings.cost.includes_look else float(self.config.cost_of_view)

    def _apart(self, options: Options, utility: FloatArray) -> FloatArray:
        """The utilities, lowered by their range for views that are like a better one."""
        values, config = utility.copy(), self.config
        spread = float(np.ptp(utility)) + 1.0 if len(utility) else 0.0
        look_ahead_kernels.lower_alike(
            np.argsort(-utility, kind="stable"),
            np.ascontiguousarray(options.positions),
            np.ascontiguousarray(options.poses[:, :3, 2]),
            config.unlike_distance,
            math.cos(config.unlike_angle),
            spread,
            values,
        )
        return values

    def _search(
        self, options: Options, ratings: Ratings, alone: FloatArray, chosen: IntArray
    ) -> Scores:
        """Worth of every view, and the followers of those that were looked into."""
        config, values = self.config, alone.copy()
        costs = look_ahead_kernels.Costs(
            ratings.config.information_weight * ratings.shares[chosen],
            1.0 - ratings.terms["risk"][chosen],
            ratings.ratings[chosen],
            ratings.ways[chosen],
            _distances_between(options, ratings, chosen),
            float(ratings.cost.weight_of_distance),
            self._cost_of_view(ratings),
            float(config.discount_distance),
        )
        found = np.empty(len(chosen))
        followers = np.empty((len(chosen), config.depth - 1), np.int64)
        look_ahead_kernels.best_sequences(
            _sharing_of(options, chosen), costs, config.depth, config.beam, found, followers
        )
        values[chosen] = found
        plans = {
            int(first): tuple(int(chosen[view]) for view in others if view >= 0)
            for first, others in zip(chosen, followers, strict=True)
        }
        return Scores(values, {first: others for first, others in plans.items() if others})


def _distances_between(options: Options, ratings: Ratings, chosen: IntArray) -> FloatArray:
    """Cost of eq. (10) from each of the chosen views to each, as distances, shape (K, K)."""
    cost, poses = ratings.cost, options.poses[chosen]
    spots, at = np.unique(poses[:, :3, 3], axis=0, return_inverse=True)
    lengths = [options.surroundings.path_lengths_from(spot, poses[:, :3, 3]) for spot in spots]
    pairs = zip(poses, np.ravel(at), strict=True)
    rows = [cost.between(pose, poses, lengths[spot]) for pose, spot in pairs]
    return np.array(rows).reshape(len(poses), len(poses))


def _sharing_of(options: Options, chosen: IntArray) -> look_ahead_kernels.Sharing:
    """What voxels each of the chosen views, (K,), informs, weighted by what is wanted."""
    gains = options.source.gains(options.situation, options.poses[chosen])
    keys, places = np.unique(
        np.concatenate([gain.keys for gain in gains] or [np.empty(0, np.int64)]),
        return_inverse=True,
    )
    indices = np.empty((len(keys), 3), np.int64)
    unpack_all(keys, len(keys), indices)
    centers = np.asarray((indices + 0.5) * options.surroundings.voxel_size, dtype=np.float64)
    information_weights = options.information_weights.of(options.surroundings, centers).prod(axis=1)
    places = np.ravel(places).astype(np.int64)
    values = (
        np.concatenate([gain.gains for gain in gains] or [np.empty(0)])
        * information_weights[places]
    )
    starts = np.cumsum([0, *(len(gain.keys) for gain in gains)])
    return look_ahead_kernels.Sharing(starts, places, values, len(keys))
