"""More than one view ahead: sequences of views that share no information."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from infomap_ros.geometry.config import check_config, setting
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.mapping.voxels.keys import unpack_all
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
        "Information that comes after this distance (eq. 10) counts 1/e of what comes at once.",
        low=0.01,
        high=1e6,
    )
    cost_of_view: float = setting(2.0, "A view costs as much as this distance.", low=0.0, high=1e6)
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
        distance = ratings.distances + self._cost_of_view(ratings)
        near = np.exp(-distance / self.config.discount_distance)
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
        lower_alike(
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
        costs = Costs(
            ratings.config.information_weight * ratings.shares[chosen],
            1.0 - ratings.terms["risk"][chosen],
            ratings.ratings[chosen],
            ratings.distances[chosen],
            _distances_between(options, ratings, chosen),
            float(ratings.cost.weight_of_distance),
            self._cost_of_view(ratings),
            float(config.discount_distance),
        )
        found = np.empty(len(chosen))
        followers = np.empty((len(chosen), config.depth - 1), np.int64)
        best_sequences(
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


def _sharing_of(options: Options, chosen: IntArray) -> Sharing:
    """What voxels each of the chosen views, (K,), informs, weighted by what is wanted."""
    gains = options.source.gains(options.situation, options.poses[chosen])
    keys, places = np.unique(
        np.concatenate([gain.keys for gain in gains] or [np.empty(0, np.int64)]),
        return_inverse=True,
    )
    size = options.surroundings.voxel_size
    centers = np.asarray((unpack_all(keys) + 0.5) * size, np.float64)
    information_weights = options.information_weights.of(options.surroundings, centers).prod(axis=1)
    places = np.ravel(places).astype(np.int64)
    values = (
        np.concatenate([gain.gains for gain in gains] or [np.empty(0)])
        * information_weights[places]
    )
    starts = np.cumsum([0, *(len(gain.keys) for gain in gains)])
    return Sharing(starts, places, values, len(keys))


class Sharing(NamedTuple):
    """What voxels each of K views informs, and by how much.

    Attributes:
        starts: where the voxels of each view begin in the next two, shape (K + 1,), int64.
        places: of the voxels in an array of `size`, int64.
        gains: of the voxels.
        size: number of voxels that any view informs.
    """

    starts: NDArray[np.int64]
    places: NDArray[np.int64]
    gains: FloatArray
    size: int


class Costs(NamedTuple):
    """What a sequence of views counts.

    Attributes:
        utility: of each view's information before any of it is informed, shape (K,) [full views].
        safe: probability that its place is free, shape (K,).
        ratings: of each view as the first one, shape (K,) [full views].
        first: distance to each view from where the camera is, shape (K,).
        between: distance from each view to each, shape (K, K).
        weight: what a unit of distance costs [full views].
        look: a view costs as much as this distance.
        discount_distance: what comes after this distance counts 1/e.
    """

    utility: FloatArray
    safe: FloatArray
    ratings: FloatArray
    first: FloatArray
    between: FloatArray
    weight: float
    look: float
    discount_distance: float


@njit(cache=True, nogil=True)
def best_sequences(
    sharing: Sharing, costs: Costs, depth: int, beam: int, values: Any, followers: Any
) -> None:
    """Worth of the best sequence that starts with each view, found by a beam search.

    Args:
        sharing: see `Sharing`.
        costs: see `Costs`.
        depth: longest sequence.
        beam: so many of the best sequences of each length are continued.
        values: shape (K,), receives the utility.
        followers: shape (K, depth - 1), receives the views that follow; -1 where there are no more.
    """
    count = len(costs.first)
    followers[:] = -1
    views, distances = np.empty((count, depth), np.int64), np.empty(count)
    utilities = np.empty(count)
    for view in range(count):
        views[view, 0] = view
        distances[view] = costs.first[view] + costs.look
        utilities[view] = _discounted(costs.ratings[view], distances[view], costs.discount_distance)
        values[view] = utilities[view]
    for length in range(1, depth):
        longer, farther = _longer(sharing, costs, views, length, utilities, distances)
        kept = _kept(longer, views, length, beam)
        views, utilities, distances = _continued(views, length, longer, farther, kept)
        for row in range(len(kept)):
            start = views[row, 0]
            if utilities[row] > values[start]:
                values[start] = utilities[row]
                followers[start] = -1
                followers[start, :length] = views[row, 1 : length + 1]


@njit(cache=True, nogil=True)
def _discounted(rating: float, distance: float, discount_distance: float) -> float:
    """Of gains; what costs more than it brings is not made better by coming late."""
    return rating * math.exp(-distance / discount_distance) if rating > 0.0 else rating


@njit(cache=True, nogil=True)
def _longer(
    sharing: Sharing, costs: Costs, views: Any, length: int, utilities: Any, distances: Any
) -> tuple[Any, Any]:
    """Worth and distance of every sequence continued with every view, (N, K) each.

    The utility is -inf for a view that the sequence holds.
    """
    count = len(costs.first)
    longer, farther = np.full((len(utilities), count), -np.inf), np.empty((len(utilities), count))
    informed = np.empty(sharing.size)
    for row in range(len(utilities)):
        informed[:] = 0.0
        for turn in range(length):
            _inform(sharing, views[row, turn], informed)
        for view in range(count):
            if _holds(views[row], length, view):
                continue
            step = costs.between[views[row, length - 1], view]
            gained = costs.utility[view] * _unshared(sharing, view, informed)
            rating = (gained - costs.weight * step) * costs.safe[view]
            farther[row, view] = distances[row] + step + costs.look
            gain = _discounted(rating, farther[row, view], costs.discount_distance)
            longer[row, view] = utilities[row] + gain
    return longer, farther


@njit(cache=True, nogil=True)
def _holds(views: Any, length: int, view: int) -> bool:
    found = False
    for turn in range(length):
        found = found or views[turn] == view
    return found


@njit(cache=True, nogil=True)
def _inform(sharing: Sharing, view: int, informed: Any) -> None:
    """Note in `informed`, shape (size,), what a view informs."""
    for entry in range(sharing.starts[view], sharing.starts[view + 1]):
        place = sharing.places[entry]
        informed[place] = max(informed[place], sharing.gains[entry])


@njit(cache=True, nogil=True)
def _unshared(sharing: Sharing, view: int, informed: Any) -> float:
    """Share of what a view informs that is not `informed`, shape (size,), yet."""
    gained, total = 0.0, 0.0
    for entry in range(sharing.starts[view], sharing.starts[view + 1]):
        gain = sharing.gains[entry]
        gained += max(gain - informed[sharing.places[entry]], 0.0)
        total += gain
    return gained / max(total, 1e-12)


@njit(cache=True, nogil=True)
def _kept(longer: Any, views: Any, length: int, beam: int) -> Any:
    """The best sequences, as flat indices; of those with the same views, ends alike, only one."""
    flat = longer.ravel()
    count, order = longer.shape[1], np.argsort(-flat)
    kept, number = np.empty(min(beam, len(flat)), np.int64), 0
    for index in order:
        if number == len(kept) or flat[index] == -np.inf:
            break
        repeated = False
        for other in kept[:number]:
            row, before = views[index // count], views[other // count]
            alike = index % count == other % count and row[0] == before[0]
            if alike and _same_views(row, before, length):
                repeated = True
                break
        if not repeated:
            kept[number] = index
            number += 1
    return kept[:number]


@njit(cache=True, nogil=True)
def _same_views(one: Any, other: Any, length: int) -> bool:
    same = True
    for turn in range(length):
        same = same and _holds(other, length, one[turn])
    return same


@njit(cache=True, nogil=True)
def _continued(
    views: Any, length: int, longer: Any, farther: Any, kept: Any
) -> tuple[Any, Any, Any]:
    """The kept sequences with their utilities and distances."""
    count = longer.shape[1]
    continued = np.empty((len(kept), views.shape[1]), np.int64)
    for row in range(len(kept)):
        continued[row] = views[kept[row] // count]
        continued[row, length] = kept[row] % count
    return continued, longer.ravel()[kept], farther.ravel()[kept]


@njit(cache=True, nogil=True)
def lower_alike(
    order: Any, positions: Any, axes: Any, distance: float, cosine: float, by: float, values: Any
) -> None:
    """Lower the values of views that are like a better one.

    Args:
        order: of the views, best first, shape (M,).
        positions: of the views, shape (M, 3).
        axes: their optical axes, shape (M, 3).
        distance: views are alike that are nearer than this, and
        cosine: the cosine of whose angle is larger than this.
        by: how much to take off.
        values: shape (M,).
    """
    is_open = np.ones(len(order), np.bool_)
    for rank in range(len(order)):
        best = order[rank]
        if not is_open[best]:
            continue
        for later in range(rank + 1, len(order)):
            view = order[later]
            if not is_open[view]:
                continue
            square, along = 0.0, 0.0
            for axis in range(3):
                square += (positions[view, axis] - positions[best, axis]) ** 2
                along += axes[view, axis] * axes[best, axis]
            if square < distance * distance and along > cosine:
                is_open[view] = False
                values[view] -= by
