"""Compiled search for a way of the arm; the public form is `arm_path.plan_arm_path`."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from infomap_ros.motion.base.way_kernels import first_on_way


class Trees(NamedTuple):
    """Two trees of configurations, one from the start, one from the goal.

    Attributes:
        nodes: shape (2, capacity, n) [rad or m].
        parents: row that a node was reached from, -1 for the root, shape (2, capacity).
        counts: nodes in use, shape (2,).
    """

    nodes: NDArray[np.float64]
    parents: NDArray[np.int64]
    counts: NDArray[np.int64]


@njit(cache=True, nogil=True)
def distance(first: Any, second: Any, weights: Any) -> float:
    """Weighted Euclidean distance of two configurations [m]."""
    total = 0.0
    for j in range(len(first)):
        offset = weights[j] * (first[j] - second[j])
        total += offset * offset
    return math.sqrt(total)


@njit(cache=True, nogil=True)
def _nearest(nodes: Any, count: int, q: Any, weights: Any) -> int:
    best, nearest = math.inf, 0
    for i in range(count):
        total = 0.0
        for j in range(len(q)):
            offset = weights[j] * (nodes[i, j] - q[j])
            total += offset * offset
        if total < best:
            best, nearest = total, i
    return nearest


@njit(cache=True, nogil=True)
def _extend(
    space: Any,
    trees: Any,
    side: int,
    near: int,
    target: Any,
    weights: Any,
    step: float,
    places: Any,
) -> int:
    """Grow a tree from a node one step towards a target.

    Returns:
        The new node, which is the target where that is within a step, or -1.
    """
    nodes, parents, counts = trees
    count = counts[side]
    if count >= nodes.shape[1]:
        return -1
    away = distance(nodes[side, near], target, weights)
    share = min(1.0, step / away) if away > 0.0 else 1.0
    new = nodes[side, count]
    for j in range(len(new)):
        new[j] = nodes[side, near, j] + share * (target[j] - nodes[side, near, j])
        if share == 1.0:
            new[j] = target[j]
    if first_on_way(space, nodes[side, near], new, places) >= 0.0:
        return -1
    parents[side, count] = near
    counts[side] = count + 1
    return count


@njit(cache=True, nogil=True)
def grow(
    space: Any, trees: Any, samples: Any, weights: Any, step: float, places: Any, joint: Any
) -> bool:
    """RRT-Connect (Kuffner and LaValle 2000, doi:10.1109/ROBOT.2000.844730) over some samples.

    Args:
        space: a `collision.kernels.MotionSpace`.
        trees: `Trees` with their roots set; grown.
        samples: random configurations, shape (K, n).
        weights: of the joints in a distance, shape (n,) [m/rad or 1].
        step: longest new branch [m].
        places: scratch for poses of bodies.
        joint: receives the nodes of both trees that are the same configuration, shape (2,).

    Returns:
        Whether the trees have met.
    """
    nodes, _, counts = trees
    for i in range(len(samples)):
        side = i % 2
        near = _nearest(nodes[side], counts[side], samples[i], weights)
        new = _extend(space, trees, side, near, samples[i], weights, step, places)
        if new < 0:
            continue
        target, other = nodes[side, new], 1 - side
        tip = _nearest(nodes[other], counts[other], target, weights)
        while tip >= 0:
            if distance(nodes[other, tip], target, weights) == 0.0:
                joint[side], joint[other] = new, tip
                return True
            tip = _extend(space, trees, other, tip, target, weights, step, places)
    return False
