"""Compiled collision checks of a body of spheres; the public form is `checker.CollisionChecker`.

Poses are the upper three rows of a transform, shape (3, 4). A number >= 0 names what is touched,
CLEAR is nothing.

Whole segments are checked so that none of their points is left out. What is free at one
configuration is free around it: a link that is a distance d from what it must not touch may go that
far. The motion of any point of a link has a bound per unit of each joint (`BodyArrays.reach`), so d
tells what part of a segment in joint space needs no further check. This is the idea of
conservative advancement (Mirtich 1996), from the middle outwards (Schwarzer, Saha and Latombe 2005,
doi:10.1109/TRO.2004.838012).
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from infomap_ros.mapping.distance_field import clearance_bounds, nearest_blocked, sphere_clear
from infomap_ros.motion.robot.chain import compose, move

CLEAR = -1


class BodyArrays(NamedTuple):
    """A robot as spheres on links, the links on the bodies of a `link_tree.TreeArrays`.

    Attributes:
        bodies: body of each link, shape (L,).
        balls: a sphere that holds all spheres of the link: center in the body's frame and radius,
            shape (L, 4) [m].
        starts: link l has the spheres [starts[l], starts[l + 1]), shape (L + 1,).
        spheres: center in the body's frame and radius, shape (S, 4) [m].
        pairs: links that must not touch each other, shape (P, 2).
        reach: bound of the motion of any point of a link, per unit of each of the arm's positions,
            shape (L, n) [m/rad or 1].
    """

    bodies: NDArray[np.int64]
    balls: NDArray[np.float64]
    starts: NDArray[np.int64]
    spheres: NDArray[np.float64]
    pairs: NDArray[np.int64]
    reach: NDArray[np.float64]


class MotionSpace(NamedTuple):
    """Where an arm moves: what it is, and what is in its way.

    Attributes:
        tree: a `link_tree.TreeArrays`.
        body: a `BodyArrays`.
        field: a `mapping.field_kernels.FieldArrays`.
        links: links that are checked against the map, shape (M,).
        radii: radii of the spheres against the map, within the balls of `body`, shape (S,) [m].
        gaps: distance that the links of each pair keep from each other, shape (P,) [m].
        kept: part of these gaps that may be lost between two checks of a segment, shape (P,) [m].
        pair_reach: bound of the motion of any point of one link of a pair against the other, per
            unit of each of the arm's positions, shape (P, n) [m/rad or 1].
        margin: what the spheres are grown by against the map [m].
        T_map_base: shape (3, 4).
    """

    tree: Any
    body: BodyArrays
    field: Any
    links: NDArray[np.int64]
    radii: NDArray[np.float64]
    gaps: NDArray[np.float64]
    kept: NDArray[np.float64]
    pair_reach: NDArray[np.float64]
    margin: float
    T_map_base: NDArray[np.float64]


@njit(cache=True, nogil=True)
def place_bodies(tree: Any, q: Any, T_map_base: Any, places: Any) -> None:
    """Place all bodies, `places` shape (B + 1, 3, 4), the base first."""
    parents, columns, scales, offsets, prismatic, placements = tree
    places[0] = T_map_base
    for k in range(len(parents)):
        compose(places[parents[k]], placements[k], places[k + 1])
        move(places[k + 1], prismatic[k], scales[k] * q[columns[k]] + offsets[k])


@njit(cache=True, nogil=True, inline="always")
def placed(place: Any, ball: Any) -> tuple[float, float, float]:
    """Center of a sphere, given in the frame of a body that is placed at `place`."""
    x, y, z = ball[0], ball[1], ball[2]
    return (
        place[0, 0] * x + place[0, 1] * y + place[0, 2] * z + place[0, 3],
        place[1, 0] * x + place[1, 1] * y + place[1, 2] * z + place[1, 3],
        place[2, 0] * x + place[2, 1] * y + place[2, 2] * z + place[2, 3],
    )


@njit(cache=True, nogil=True)
def map_contact(body: Any, field: Any, links: Any, radii: Any, margin: float, places: Any) -> int:
    """First sphere that touches what is blocked in the map, or CLEAR."""
    distances, first, size, outside_is_free = field
    bodies, balls, starts, spheres = body.bodies, body.balls, body.starts, body.spheres
    for link in links:
        place, ball = places[bodies[link]], balls[link]
        x, y, z = placed(place, ball)
        low, _ = clearance_bounds(distances, first, size, outside_is_free, x, y, z)
        if low > ball[3] + margin:
            continue
        for s in range(starts[link], starts[link + 1]):
            x, y, z = placed(place, spheres[s])
            radius = radii[s] + margin
            if not sphere_clear(distances, first, size, outside_is_free, x, y, z, radius):
                return s
    return CLEAR


@njit(cache=True, nogil=True)
def pair_gap(body: Any, pair: int, limit: float, places: Any) -> float:
    """Least distance of the spheres of two links, negative where they overlap, at most `limit`."""
    spheres, starts = body.spheres, body.starts
    a, b = body.pairs[pair, 0], body.pairs[pair, 1]
    here, there = places[body.bodies[a]], places[body.bodies[b]]
    ball_a, ball_b = body.balls[a], body.balls[b]
    bx, by, bz = placed(there, ball_b)
    x, y, z = placed(here, ball_a)
    reach = ball_a[3] + ball_b[3] + limit
    if (x - bx) ** 2 + (y - by) ** 2 + (z - bz) ** 2 > reach * reach:
        return limit
    best = limit
    for s in range(starts[a], starts[a + 1]):
        x, y, z = placed(here, spheres[s])
        reach = spheres[s, 3] + ball_b[3] + best
        if reach <= 0.0 or (x - bx) ** 2 + (y - by) ** 2 + (z - bz) ** 2 > reach * reach:
            continue
        for t in range(starts[b], starts[b + 1]):
            u, v, w = placed(there, spheres[t])
            sizes = spheres[s, 3] + spheres[t, 3]
            square, reach = (x - u) ** 2 + (y - v) ** 2 + (z - w) ** 2, sizes + best
            if reach > 0.0 and square < reach * reach:
                best = math.sqrt(square) - sizes
    return best


@njit(cache=True, nogil=True)
def self_contact(body: Any, gaps: Any, places: Any) -> int:
    """First pair of links nearer to each other than its gap, or CLEAR."""
    for pair in range(len(body.pairs)):
        if pair_gap(body, pair, gaps[pair], places) < gaps[pair]:
            return pair
    return CLEAR


@njit(cache=True, nogil=True)
def is_free(space: Any, q: Any, T_map_base: Any, places: Any) -> bool:
    """Whether a configuration touches nothing; `places` is scratch, shape (B + 1, 3, 4)."""
    place_bodies(space.tree, q, T_map_base, places)
    if self_contact(space.body, space.gaps, places) != CLEAR:
        return False
    touched = map_contact(space.body, space.field, space.links, space.radii, space.margin, places)
    return touched == CLEAR


@njit(cache=True, nogil=True)
def all_free(space: Any, qs: Any, T_map_bases: Any, free: Any) -> None:
    """`is_free` for configurations, shape (N, n), each with its base pose, shape (N, 3, 4)."""
    places = np.empty((len(space.tree.parents) + 1, 3, 4))
    for i in range(len(qs)):
        free[i] = is_free(space, qs[i], T_map_bases[i], places)


@njit(cache=True, nogil=True)
def first_contact(space: Any, q: Any) -> tuple[int, int, float, float, float]:
    """What a configuration touches, for a message.

    Returns:
        The pair of links that touch, or CLEAR; the sphere that touches the map, or CLEAR; and where
        that sphere is: x, y, z [m].
    """
    places = np.empty((len(space.tree.parents) + 1, 3, 4))
    place_bodies(space.tree, q, space.T_map_base, places)
    pair = self_contact(space.body, space.gaps, places)
    sphere = map_contact(space.body, space.field, space.links, space.radii, space.margin, places)
    x, y, z = 0.0, 0.0, 0.0
    if sphere != CLEAR:
        link = np.searchsorted(space.body.starts, sphere, side="right") - 1
        x, y, z = placed(places[space.body.bodies[link]], space.body.spheres[sphere])
    return pair, sphere, x, y, z


@njit(cache=True, nogil=True)
def sphere_clearances(space: Any, q: Any, limits: Any, found: Any) -> None:
    """Distance of each sphere's center to what is blocked, at most its limit, shapes (S,) [m]."""
    distances, first, size, outside_is_free = space.field
    places = np.empty((len(space.tree.parents) + 1, 3, 4))
    place_bodies(space.tree, q, space.T_map_base, places)
    body = space.body
    for link in range(len(body.bodies)):
        for s in range(body.starts[link], body.starts[link + 1]):
            x, y, z = placed(places[body.bodies[link]], body.spheres[s])
            low, _ = clearance_bounds(distances, first, size, outside_is_free, x, y, z)
            found[s] = limits[s]
            if low < limits[s]:
                found[s] = nearest_blocked(
                    distances, first, size, outside_is_free, x, y, z, limits[s]
                )


@njit(cache=True, nogil=True)
def pair_gaps(space: Any, q: Any, limits: Any, found: Any) -> None:
    """`pair_gap` of all pairs, each with its limit, shapes (P,) [m]."""
    places = np.empty((len(space.tree.parents) + 1, 3, 4))
    place_bodies(space.tree, q, space.T_map_base, places)
    for pair in range(len(found)):
        found[pair] = pair_gap(space.body, pair, limits[pair], places)


@njit(cache=True, nogil=True)
def place_spheres(tree: Any, body: Any, q: Any, T_map_base: Any, out: Any) -> None:
    """Centers and radii of all spheres in the map, shape (S, 4)."""
    places = np.empty((len(tree.parents) + 1, 3, 4))
    place_bodies(tree, q, T_map_base, places)
    for link in range(len(body.bodies)):
        for s in range(body.starts[link], body.starts[link + 1]):
            x, y, z = placed(places[body.bodies[link]], body.spheres[s])
            out[s, 0], out[s, 1], out[s, 2], out[s, 3] = x, y, z, body.spheres[s, 3]


_FARTHEST = 0.1  # [m]; distances beyond the margin are measured up to here


@njit(cache=True, nogil=True)
def first_on_segment(space: Any, first: Any, second: Any, places: Any) -> float:
    """Share of the segment between two configurations at which something is touched, or -1.

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
    """Bound of the motion of any point of each link, or of a link against another one, [m]."""
    rates = np.zeros(len(reach))
    for link in range(len(reach)):
        for j in range(len(first)):
            rates[link] += abs(second[j] - first[j]) * reach[link, j]
    return rates


@njit(cache=True, nogil=True)
def _free_share(space: Any, rates: Any, q: Any, wanted: float, places: Any) -> float:
    """Share of the segment that is free before and behind a configuration, at most about `wanted`.

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
