"""A random tree through known free space."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.mapping import FREE
from infomap_ros.studies.common.flight import is_open_line
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
