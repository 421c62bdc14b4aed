"""Compiled search for a good order in which to take views."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numba import njit

_LONGEST = 3  # views that are moved together
_GAIN = 1e-9  # below which nothing is improved


@njit(cache=True, nogil=True)
def tour_utility(
    order: Any, count: int, first: Any, between: Any, prizes: Any, settings: Any
) -> float:
    """Utility of taking views in an order.

    ``sum_i p_i exp(-D_i / discount_distance) - weight D_last``, D the way until view i, each view
    included.

    Args:
        order: views, shape (K,); the first `count` are taken.
        count: see above.
        first: way to each view from where the camera is, shape (K,).
        between: ways between them, shape (K, K).
        prizes: of the views, shape (K,).
        settings: discount_distance, weight of the way, and the way that a view costs besides.
    """
    way, utility = 0.0, 0.0
    for n in range(count):
        view = order[n]
        way += (first[view] if n == 0 else between[order[n - 1], view]) + settings[2]
        utility += prizes[view] * math.exp(-way / settings[0])
    return utility - settings[1] * way


@njit(cache=True, nogil=True)
def build_tour(
    order: Any, count: int, fixed: int, first: Any, between: Any, prizes: Any, settings: Any
) -> int:
    """Insert views where each adds most, as long as one adds something; returns their number.

    The first `fixed` views of `order` keep their place; its first `count` are taken already.
    Other arguments as for `tour_utility`.
    """
    taken = np.zeros(len(order), np.bool_)
    for n in range(count):
        taken[order[n]] = True
    utility = tour_utility(order, count, first, between, prizes, settings)
    while count < len(order):
        best, best_view, best_place = utility + _GAIN, -1, 0
        for view in range(len(order)):
            if taken[view]:
                continue
            for place in range(fixed, count + 1):
                _insert(order, count, place, view)
                value = tour_utility(order, count + 1, first, between, prizes, settings)
                if value > best:
                    best, best_view, best_place = value, view, place
                _remove(order, count + 1, place)
        if best_view < 0:
            break
        _insert(order, count, best_place, best_view)
        taken[best_view] = True
        count, utility = count + 1, best
    return count


@njit(cache=True, nogil=True)
def improve_tour(
    order: Any, count: int, fixed: int, first: Any, between: Any, prizes: Any, settings: Any
) -> float:
    """Reverse parts and move short parts as long as that helps; returns the utility.

    Arguments as for `build_tour`.
    """
    utility = tour_utility(order, count, first, between, prizes, settings)
    trial, best = order.copy(), order.copy()
    while True:
        start = utility
        for i in range(fixed, count):
            for j in range(i + 1, count):
                trial[:count] = order[:count]
                for n in range(i, j + 1):
                    trial[n] = order[i + j - n]
                value = tour_utility(trial, count, first, between, prizes, settings)
                if value > utility + _GAIN:
                    utility, best[:count] = value, trial[:count]
        for i in range(fixed, count):
            for length in range(1, min(_LONGEST, count - i) + 1):
                for place in range(fixed, count - length + 1):
                    _move(order, count, i, length, place, trial)
                    value = tour_utility(trial, count, first, between, prizes, settings)
                    if value > utility + _GAIN:
                        utility, best[:count] = value, trial[:count]
        if utility <= start:
            return utility
        order[:count] = best[:count]


@njit(cache=True, nogil=True)
def _insert(order: Any, count: int, place: int, view: int) -> None:
    for n in range(count, place, -1):
        order[n] = order[n - 1]
    order[place] = view


@njit(cache=True, nogil=True)
def _remove(order: Any, count: int, place: int) -> None:
    for n in range(place, count - 1):
        order[n] = order[n + 1]


@njit(cache=True, nogil=True)
def _move(order: Any, count: int, start: int, length: int, place: int, out: Any) -> None:
    """Copy an order with the part of `length` from `start` moved to `place` in what is left."""
    written, left = 0, 0
    for n in range(count):
        if left == place and written < count:
            for m in range(length):
                out[written] = order[start + m]
                written += 1
            left = -count  # done
        if n < start or n >= start + length:
            out[written] = order[n]
            written += 1
            left += 1
    if left == place:
        for m in range(length):
            out[written] = order[start + m]
            written += 1
