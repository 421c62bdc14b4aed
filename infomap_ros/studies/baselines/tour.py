"""Short open tours: the nearest place next, then improved by exchanges."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from infomap_ros.geometry.transforms import FloatArray

_FAR = 1e6  # stands for no way [m]


def open_tour(first: FloatArray, between: FloatArray) -> NDArray[np.int64]:
    """An order in which to visit places, from a start and without coming back.

    Nearest place first, improved by reversing parts (2-opt) and by moving single places (Or-opt)
    until neither shortens the tour: G. A. Croes 1958, doi:10.1287/opre.6.6.791.

    Args:
        first: ways from the start, shape (n,) [m]; inf where there is none.
        between: ways between the places, shape (n, n) [m], symmetric.

    Returns:
        The order, shape (n,).
    """
    count = len(first)
    ways = np.full((count + 1, count + 1), 0.0)
    ways[0, 1:] = np.minimum(first, _FAR)
    ways[1:, 1:] = np.minimum(between, _FAR)
    left, order = set(range(1, count + 1)), [0]
    while left:
        here = ways[order[-1]]
        order.append(min(left, key=lambda place: float(here[place])))
        left.remove(order[-1])
    improved = True
    while improved:
        improved = _reverse_once(order, ways) or _move_once(order, ways)
    return np.array(order[1:], np.int64) - 1


def tour_length(order: NDArray[np.int64], first: FloatArray, between: FloatArray) -> float:
    """Length of an order of visit [m]."""
    if not len(order):
        return 0.0
    return float(first[order[0]] + between[order[:-1], order[1:]].sum())


def _reverse_once(order: list[int], ways: FloatArray) -> bool:
    """Reverse the part that shortens the tour most, if any does."""
    best, where = -1e-9, (0, 0)
    path = np.array(order)
    for i in range(1, len(path) - 1):
        ends = path[i + 1 :]
        before = ways[path[i - 1], path[i]]
        change = ways[path[i - 1], ends] - before
        change[:-1] += ways[path[i], ends[1:]] - ways[ends[:-1], ends[1:]]
        j = int(change.argmin())
        if change[j] < best:
            best, where = float(change[j]), (i, i + 1 + j)
    i, j = where
    if j:
        order[i : j + 1] = order[i : j + 1][::-1]
    return bool(j)


def _move_once(order: list[int], ways: FloatArray) -> bool:
    """Move one place to where it costs least, if that shortens the tour."""
    path = np.array(order)
    for i in range(1, len(path)):
        place = path[i]
        rest = np.delete(path, i)
        saved = ways[path[i - 1], place]
        if i + 1 < len(path):
            saved += ways[place, path[i + 1]] - ways[path[i - 1], path[i + 1]]
        cost = ways[rest, place].copy()
        cost[:-1] += ways[place, rest[1:]] - ways[rest[:-1], rest[1:]]
        at = int(cost.argmin())
        if cost[at] < saved - 1e-9 and at != i - 1:
            order[:] = [*rest[: at + 1], place, *rest[at + 1 :]]
            return True
    return False
