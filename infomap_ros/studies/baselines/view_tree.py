"""The receding-horizon next-best-view planner.

A. Bircher, M. Kamel, K. Alexis, H. Oleynikova, R. Siegwart, "Receding Horizon 'Next-Best-View'
Planner for 3D Exploration", ICRA 2016, doi:10.1109/ICRA.2016.7487281.

A random tree through known free space.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.mapping import FREE
from infomap_ros.studies.baselines.frontiers import level_views, places_of, scores_of, told_by
from infomap_ros.studies.common.flight import is_open_line
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
        lengths: of the way from the root, shape (n,) [m].
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
_DECAY = 2.5  # of the gain over one range of way: 0.5 per meter and 5 m of range in the paper
_NOTHING = 0.01  # a best branch of less gives rise to a larger tree [full views]


class ViewTree:
    """Takes the first view of the best branch of a random tree of views.

    The gain of a node is that of its parent plus the information of its view times exp(-lambda c),
    c the way from the root; eq. (1) of the paper. The rest of the best branch begins the next tree.
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
        told = told_by(options, ratings, places)
        told *= np.exp(-_DECAY * tree.lengths / options.situation.max_range)
        gains = np.zeros(len(told))
        for node in range(len(told)):
            parent = tree.parents[node]
            gains[node] = told[node] + (gains[parent] if parent >= 0 else 0.0)
        best = int(gains.argmax())
        branch = tree.branch(best)
        self._nodes = _NODES if gains[best] > _NOTHING else _MORE_NODES
        self._values = np.full(len(told), -1e7)
        if gains[best] > 0.0 and found[branch[0]]:
            self._values = np.zeros(len(told))
            self._values[branch[0]] = 1.0
        self._kept, self._kept_azimuths = tree.places[branch[1:]], self._azimuths[branch[1:]]
