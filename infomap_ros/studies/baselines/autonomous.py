"""Autonomous exploration planning: a local tree, and cached gains where that finds nothing.

M. Selin, M. Tiger, D. Duberg, F. Heintz, P. Jensfelt, "Efficient Autonomous Exploration Planning of
Large-Scale 3-D Environments", RA-L 4(2), 2019, doi:10.1109/LRA.2019.2897343.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.studies.baselines.frontiers import places_of, scores_of, told_by, turned_views
from infomap_ros.studies.baselines.view_tree import Tree, grow_tree
from infomap_ros.views.ranking.options import Options
from infomap_ros.views.ranking.rating import Ratings
from infomap_ros.views.ranking.strategy import Scores
from infomap_ros.views.sampling.surroundings import Surroundings
from infomap_ros.views.situation import Situation

_NODES = 40
_EDGE = 0.5  # [ranges]
_RADIUS = 2.0  # of the local tree [ranges]
_DECAY = 2.5  # of the gain over one range of way
_TURNS = 8
_CACHED = 80
_NOTHING = 0.05  # a view that tells less is no goal [full views]


class AutonomousExploration:
    """The best view of a local tree; where none tells enough, the nearest cached one that does.

    The score of a node is the information of its best direction times exp(-lambda c), c the way.
    Nodes that told enough are remembered, and asked again, as frontiers to come back to.
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
            situation, surroundings, rng, _NODES, _EDGE * reach, _RADIUS * reach, self._kept
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
        told = told_by(options, ratings, places)
        turns = told.reshape(-1, _TURNS)
        best_turn, gains = turns.argmax(axis=1), turns.max(axis=1)
        local, reach = len(self._tree.places), options.situation.max_range
        scores = gains[:local] * np.exp(-_DECAY * self._tree.lengths / reach)
        best = int(scores.argmax())
        self._kept = np.empty((0, 3))
        if scores[best] > _NOTHING:
            branch = self._tree.branch(best) if best else [0]
            goal, self._kept = branch[0], self._tree.places[branch[1:]]
        else:
            lengths = np.where(places >= 0, options.path_lengths[places], np.inf)
            ways = lengths.reshape(-1, _TURNS)[np.arange(len(gains)), best_turn]
            goal = int(np.where(gains > _NOTHING, ways, np.inf).argmin())
        self._values = np.zeros(len(told)) if gains[goal] > 0.0 else np.full(len(told), -1e7)
        self._values[goal * _TURNS + best_turn[goal]] += 1.0
        self._remember(gains)

    def _remember(self, gains: FloatArray) -> None:
        places = np.concatenate([self._tree.places, self._cache])
        useful = np.flatnonzero(gains > _NOTHING)
        useful = useful[np.argsort(-gains[useful], kind="stable")[:_CACHED]]
        self._cache = np.unique(places[useful], axis=0)
