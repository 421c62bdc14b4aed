"""Two planners that grow a random tree through known free space.

`ViewTree`: A. Bircher, M. Kamel, K. Alexis, H. Oleynikova, R. Siegwart, "Receding Horizon
'Next-Best-View' Planner for 3D Exploration", ICRA 2016, doi:10.1109/ICRA.2016.7487281.

`AutonomousExploration`, with cached gains where the tree finds nothing: M. Selin, M. Tiger,
D. Duberg, F. Heintz, P. Jensfelt, "Efficient Autonomous Exploration Planning of Large-Scale 3-D
Environments", RA-L 4(2), 2019, doi:10.1109/LRA.2019.2897343.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.mapping import FREE
from infomap_ros.studies.baselines.frontiers import (
    level_views,
    places_of,
    scores_of,
    shares_of,
    turned_views,
)
from infomap_ros.studies.flight import is_open_line
from infomap_ros.views.ranking.options import Options
from infomap_ros.views.ranking.rating import Ratings
from infomap_ros.views.ranking.strategy import Scores
from infomap_ros.views.sampling.surroundings import Surroundings
from infomap_ros.views.situation import Situation


@dataclass(frozen=True, eq=False)
class Tree:
    """Places that are reached from each other over straight lines.

    Attributes:
        places: shape (n, 3) [m, map]; the first is the root, where the camera is.
        parents: shape (n,), -1 for the root. A parent comes before its children.
        lengths: of the path from the root, shape (n,) [m].
    """

    places: FloatArray
    parents: NDArray[np.int64]
    lengths: FloatArray

    def branch(self, node: int) -> list[int]:
        """Nodes from the root's child to a node."""
        nodes = [node]
        while self.parents[nodes[-1]] > 0:
            nodes.append(int(self.parents[nodes[-1]]))
        return nodes[::-1]


def grow_tree(
    situation: Situation,
    surroundings: Surroundings,
    rng: np.random.Generator,
    nodes: int,
    edge: float,
    radius: float = np.inf,
    kept: FloatArray | None = None,
) -> Tree:
    """Grow a rapidly-exploring random tree (LaValle 1998) through known free space.

    Args:
        situation: what is known.
        surroundings: its known space; samples are drawn from what is reached of it.
        rng: draws them.
        nodes: number of nodes, at most; four times as many samples are drawn.
        edge: longest edge [m].
        radius: samples lie so near to the camera [m].
        kept: places of a branch of the last tree, root's child first, shape (k, 3).
    """
    size, first = surroundings.voxel_size, surroundings.window.first
    is_free = surroundings.states == FREE
    places, parents, lengths = [situation.position], [-1], [0.0]

    def add(parent: int, place: FloatArray) -> bool:
        start = places[parent] / size - first
        if not is_open_line(is_free, start, place / size - first):
            return False
        places.append(place)
        parents.append(parent)
        lengths.append(lengths[parent] + float(np.linalg.norm(place - places[parent])))
        return True

    for place in kept if kept is not None else ():
        if not add(len(places) - 1, place):
            break
    flat = np.flatnonzero(surroundings.reached)
    if np.isfinite(radius):
        flat = surroundings.reached_near(radius)
    for sample in surroundings.centers(rng.choice(flat, 4 * nodes)) if len(flat) else ():
        if len(places) >= nodes:
            break
        gaps = np.linalg.norm(np.array(places) - sample, axis=1)
        nearest = int(gaps.argmin())
        if gaps[nearest] < size:
            continue
        step = places[nearest] + (sample - places[nearest]) * min(1.0, edge / gaps[nearest])
        add(nearest, (np.floor(step / size) + 0.5) * size)
    return Tree(np.array(places), np.array(parents), np.array(lengths))


_NODES, _MORE_NODES = 100, 400
_EDGE = 0.5  # [ranges]
_DECAY = 2.5  # of the gain over one range: 0.5 per meter and 5 m of range in the paper
_NOTHING = 0.01  # a best branch of less gives rise to a larger tree [full views]


class ViewTree:
    """Takes the first view of the best branch of a random tree of views.

    The gain of a node is that of its parent plus the information of its view times exp(-lambda c),
    c the length from the root; eq. (1) of the paper. The rest of the best branch begins the next.
    """

    requires_positive_utility = False

    def __init__(self) -> None:
        self._tree = Tree(np.empty((0, 3)), np.empty(0, np.int64), np.empty(0))
        self._azimuths = np.empty(0)
        self._kept, self._kept_azimuths = np.empty((0, 3)), np.empty(0)
        self._values = np.empty(0)
        self._nodes = _NODES

    def propose(
        self, situation: Situation, surroundings: Surroundings, rng: np.random.Generator
    ) -> FloatArray:
        """A view in a random direction from every node."""
        edge = _EDGE * situation.max_range
        self._tree = grow_tree(situation, surroundings, rng, self._nodes, edge, kept=self._kept)
        azimuths = rng.uniform(-np.pi, np.pi, len(self._tree.places))
        again = min(len(self._kept), len(azimuths) - 1)
        same = np.all(self._tree.places[1 : again + 1] == self._kept[:again], axis=1)
        azimuths[1 : again + 1][same] = self._kept_azimuths[:again][same]
        self._azimuths = azimuths
        return level_views(self._tree.places, azimuths)

    def score(self, options: Options, ratings: Ratings) -> Scores:
        """1 for the first view of the best branch, 0 for the rest of the tree."""
        places = places_of(options, level_views(self._tree.places, self._azimuths))
        if not options.fine:
            self._plan(options, ratings, places)
        return Scores(scores_of(options, places, self._values, ratings.ratings))

    def _plan(self, options: Options, ratings: Ratings, places: NDArray[np.int64]) -> None:
        tree, found = self._tree, places >= 0
        shares = shares_of(options, ratings, places)
        shares *= np.exp(-_DECAY * tree.lengths / options.situation.max_range)
        gains = np.zeros(len(shares))
        for node in range(len(shares)):
            parent = tree.parents[node]
            gains[node] = shares[node] + (gains[parent] if parent >= 0 else 0.0)
        best = int(gains.argmax())
        branch = tree.branch(best)
        self._nodes = _NODES if gains[best] > _NOTHING else _MORE_NODES
        self._values = np.full(len(shares), -1e7)
        if gains[best] > 0.0 and found[branch[0]]:
            self._values = np.zeros(len(shares))
            self._values[branch[0]] = 1.0
        self._kept, self._kept_azimuths = tree.places[branch[1:]], self._azimuths[branch[1:]]


_LOCAL_NODES = 40
_RADIUS = 2.0  # of the local tree [ranges]
_TURNS = 8
_CACHED = 80
_TOO_LITTLE = 0.05  # a view that informs less is no goal [full views]


class AutonomousExploration:
    """The best view of a local tree; where none informs enough, the nearest cached one that does.

    The score of a node is the information of its best direction times exp(-lambda c), c the length.
    Nodes that informed enough are remembered, and asked again, as frontiers to come back to.
    """

    requires_positive_utility = False

    def __init__(self) -> None:
        self._tree = Tree(np.empty((0, 3)), np.empty(0, np.int64), np.empty(0))
        self._cache = np.empty((0, 3))
        self._proposed = np.empty((0, 4, 4))
        self._kept = np.empty((0, 3))
        self._values = np.empty(0)

    def propose(
        self, situation: Situation, surroundings: Surroundings, rng: np.random.Generator
    ) -> FloatArray:
        """Views all around from the nodes of the tree and from the cached places."""
        reach = situation.max_range
        self._tree = grow_tree(
            situation, surroundings, rng, _LOCAL_NODES, _EDGE * reach, _RADIUS * reach, self._kept
        )
        self._proposed = turned_views(np.concatenate([self._tree.places, self._cache]), _TURNS)
        return self._proposed

    def score(self, options: Options, ratings: Ratings) -> Scores:
        """1 for the next view, 0 for all others that were proposed."""
        places = places_of(options, self._proposed)
        if not options.fine:
            self._plan(options, ratings, places)
        return Scores(scores_of(options, places, self._values, ratings.ratings))

    def _plan(self, options: Options, ratings: Ratings, places: NDArray[np.int64]) -> None:
        shares = shares_of(options, ratings, places)
        turns = shares.reshape(-1, _TURNS)
        best_turn, gains = turns.argmax(axis=1), turns.max(axis=1)
        local, reach = len(self._tree.places), options.situation.max_range
        scores = gains[:local] * np.exp(-_DECAY * self._tree.lengths / reach)
        best = int(scores.argmax())
        self._kept = np.empty((0, 3))
        if scores[best] > _TOO_LITTLE:
            branch = self._tree.branch(best) if best else [0]
            goal, self._kept = branch[0], self._tree.places[branch[1:]]
        else:
            lengths = np.where(places >= 0, options.path_lengths[places], np.inf)
            distances = lengths.reshape(-1, _TURNS)[np.arange(len(gains)), best_turn]
            goal = int(np.where(gains > _TOO_LITTLE, distances, np.inf).argmin())
        self._values = np.zeros(len(shares)) if gains[goal] > 0.0 else np.full(len(shares), -1e7)
        self._values[goal * _TURNS + best_turn[goal]] += 1.0
        self._remember(gains)

    def _remember(self, gains: FloatArray) -> None:
        places = np.concatenate([self._tree.places, self._cache])
        useful = np.flatnonzero(gains > _TOO_LITTLE)
        useful = useful[np.argsort(-gains[useful], kind="stable")[:_CACHED]]
        self._cache = np.unique(places[useful], axis=0)
