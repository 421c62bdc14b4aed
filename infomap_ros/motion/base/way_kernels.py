"""Compiled checks of whole ways, none of whose points is left out.

What is free at one configuration is free around it: a link that is a distance d from what it must
not touch may go that far. The way of any point of a link has a bound per unit of each joint
(`collision.kernels.BodyArrays.reach`), so d tells what part of a straight way in joint space needs
no further check. This is the idea of conservative advancement (Mirtich 1996), from the middle
outwards (Schwarzer, Saha and Latombe 2005, doi:10.1109/TRO.2004.838012).
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numba import njit

from infomap_ros.mapping.field_kernels import clearance_bounds, nearest_blocked
from infomap_ros.motion.collision.kernels import pair_gap, place_bodies, placed

_FARTHEST = 0.1  # [m]; distances beyond the margin are measured up to here


@njit(cache=True, nogil=True)
def first_on_way(space: Any, first: Any, second: Any, places: Any) -> float:
    """Share of the straight way between two configurations at which something is touched, or -1.

    Checks the ends, then the middles of what is not yet known to be free, coarse before fine.

    Args:
        space: a `collision.kernels.MotionSpace`.
        first: configuration, shape (n,).
        second: configuration, shape (n,).
        places: scratch for poses of bodies.
    """
    rates = _rates(space.body.reach, first, second), _rates(space.pair_reach, first, second)
    begin = _free_share(space, rates, first, 0.5, places)
    if begin < 0.0:
        return 0.0
    end = 1.0 - _free_share(space, rates, second, 0.5, places)
    if end > 1.0:
        return 1.0
    q, open_parts = np.empty(len(first)), [(begin, end)]
    at = 0
    while at < len(open_parts):
        low, high = open_parts[at]
        at += 1
        if low >= high:
            continue
        middle = 0.5 * (low + high)
        for j in range(len(q)):
            q[j] = first[j] + middle * (second[j] - first[j])
        free = _free_share(space, rates, q, middle - low, places)
        if free < 0.0:
            return middle
        if middle - low > free:
            open_parts.append((low, middle - free))
            open_parts.append((middle + free, high))
    return -1.0


@njit(cache=True, nogil=True)
def _rates(reach: Any, first: Any, second: Any) -> Any:
    """Bound of the way of any point of each link, or of a link against another one, [m]."""
    rates = np.zeros(len(reach))
    for link in range(len(reach)):
        for j in range(len(first)):
            rates[link] += abs(second[j] - first[j]) * reach[link, j]
    return rates


@njit(cache=True, nogil=True)
def _free_share(space: Any, rates: Any, q: Any, wanted: float, places: Any) -> float:
    """Share of the way that is free before and behind a configuration, at most about `wanted`.

    -1 where it is not free. How far beyond `wanted` it is free costs time and is not asked.
    """
    place_bodies(space.tree, q, space.T_map_base, places)
    share = _free_of_map(space, rates[0], wanted, places)
    if share < 0.0:
        return -1.0
    return _free_of_itself(space, rates[1], share, places)


@njit(cache=True, nogil=True)
def _free_of_itself(space: Any, rates: Any, share: float, places: Any) -> float:
    """Share by which links may approach each other, or -1 where two are within their gap."""
    body, gaps, kept = space.body, space.gaps, space.kept
    for pair in range(len(gaps)):
        a, b = body.pairs[pair, 0], body.pairs[pair, 1]
        rate = rates[pair]
        lowest = gaps[pair] - kept[pair]
        x, y, z = placed(places[body.bodies[a]], body.balls[a])
        u, v, w = placed(places[body.bodies[b]], body.balls[b])
        away = math.sqrt((x - u) ** 2 + (y - v) ** 2 + (z - w) ** 2)
        away -= body.balls[a, 3] + body.balls[b, 3]
        if away < gaps[pair] or away - lowest < share * rate:
            limit = max(min(_FARTHEST, lowest + share * rate), gaps[pair] + 1e-9)
            away = max(away, pair_gap(body, pair, limit, places))
            if away < gaps[pair]:
                return -1.0
            if rate > 0.0:
                share = min(share, (away - lowest) / rate)
    return share


@njit(cache=True, nogil=True)
def _free_of_map(space: Any, rates: Any, share: float, places: Any) -> float:
    """Share by which links may approach what is blocked in the map, or -1 where one touches it."""
    distances, first, size, outside_is_free = space.field
    body, margin, radii = space.body, space.margin, space.radii
    for link in space.links:
        place, ball = places[body.bodies[link]], body.balls[link]
        x, y, z = placed(place, ball)
        low, _ = clearance_bounds(distances, first, size, outside_is_free, x, y, z)
        away = low - ball[3]
        if away <= margin or away < share * rates[link]:
            away = math.inf
            for s in range(body.starts[link], body.starts[link + 1]):
                x, y, z = placed(place, body.spheres[s])
                low, high = clearance_bounds(distances, first, size, outside_is_free, x, y, z)
                if low <= radii[s] + margin:
                    if high < radii[s] + margin:
                        return -1.0
                    field = distances, first, size, outside_is_free
                    low = nearest_blocked(*field, x, y, z, (radii[s] + margin) * (1.0 + 1e-9))
                    if low < radii[s] + margin:
                        return -1.0
                away = min(away, low - radii[s])
        if rates[link] > 0.0:
            share = min(share, away / rates[link])
    return share
