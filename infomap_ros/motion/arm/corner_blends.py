"""Corners of a way through joint space that are passed without a stop.

Near a corner the way leaves its two straight pieces for a parabola, on which the velocity changes
evenly from along the one to along the other, as in Kunz and Stilman, "Time-optimal trajectory
generation for path following with bounded acceleration and velocity" (Robotics: Science and
Systems 2012, doi:10.15607/RSS.2012.VIII.027), who take circles. With the path speed v at both ends,
u and w the unit directions of the pieces, and m the largest component of |w - u|, a joint that may
accelerate by a needs the time v m / a for it. The parabola begins and ends

    h = v^2 m / (2 a)

from the corner, and passes it at v^2 m^2 / (8 a), by the joint that comes off most.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from infomap_ros.geometry.transforms import FloatArray

FreeWay = Callable[[FloatArray, FloatArray], bool]
"""Whether all of the straight way between two configurations, shape (n,) each, is free."""

_HALF = 0.45  # of a piece that a parabola may take
_INSTANT = 1e-5  # [s]
_FEWEST = 5  # knots of a parabola


@dataclass(frozen=True, eq=False)
class StraightPieces:
    """A way of straight pieces with its limits.

    Attributes:
        corners: shape (K, n) [rad or m], no two after each other the same.
        speeds: largest path speed on each piece, shape (K - 1,) [1/s].
        growths: its largest change, shape (K - 1,) [1/s^2].
        acceleration: largest of each joint [rad/s^2 or m/s^2].
    """

    corners: FloatArray
    speeds: FloatArray
    growths: FloatArray
    acceleration: float

    @classmethod
    def of(cls, corners: FloatArray, velocities: FloatArray, acceleration: float) -> StraightPieces:
        """Limits along each piece from those of the joints, shape (n,)."""
        changes = np.diff(corners, axis=0)
        units = np.abs(changes) / np.linalg.norm(changes, axis=1, keepdims=True)
        with np.errstate(divide="ignore"):
            speeds = (velocities / units).min(axis=1, initial=np.inf)
            growths = (acceleration / units).min(axis=1, initial=np.inf)
        return cls(corners, speeds, growths, acceleration)

    @property
    def lengths(self) -> FloatArray:
        """Of the pieces, shape (K - 1,)."""
        return np.asarray(np.linalg.norm(np.diff(self.corners, axis=0), axis=1))

    @property
    def directions(self) -> FloatArray:
        """Unit vectors, shape (K - 1, n)."""
        return np.asarray(np.diff(self.corners, axis=0) / self.lengths[:, None])

    @property
    def turns(self) -> FloatArray:
        """Largest component of the change of direction at each corner, the ends 0, shape (K,)."""
        inner = np.abs(np.diff(self.directions, axis=0)).max(axis=1, initial=0.0)
        return np.concatenate([[0.0], inner, [0.0]])

    def margins(self, speeds: FloatArray) -> FloatArray:
        """How far from each corner its parabola begins, shape (K,); 0 where it is as good as none.

        A parabola of no duration would put several knots at one time.
        """
        durations = speeds * self.turns / self.acceleration
        margins = 0.5 * speeds * durations
        return np.where(durations < _INSTANT, 0.0, margins)

    def parabola(self, corner: int, speed: float, period: float) -> tuple[FloatArray, FloatArray]:
        """Times [s] from the beginning, and knots: shape (k,) and (k, n), both ends with them."""
        before, after = self.directions[corner - 1 : corner + 1]
        margin = speed * self.turns[corner] * speed / (2.0 * self.acceleration)
        duration = 2.0 * margin / speed
        count = max(_FEWEST, math.ceil(duration / period - 1e-9) + 1)
        times = np.linspace(0.0, duration, count)[:, None]
        bend = 0.5 * speed * (after - before) * times**2 / max(duration, 1e-12)
        knots = self.corners[corner] - margin * before + speed * before * times + bend
        return times[:, 0], knots


def corner_speeds(
    way: StraightPieces, deviation: float, is_free: FreeWay, period: float
) -> FloatArray:
    """Path speeds at the corners, at the ends 0, that all limits allow, shape (K,).

    Args:
        way: the pieces.
        deviation: how far a joint may pass a corner [rad or m].
        is_free: asked for every chord of every parabola; where one is not, the way stops.
        period: longest time between two knots [s].
    """
    limits = _limits(way, deviation)
    while True:
        speeds = _reachable(way, limits)
        blocked = [
            corner
            for corner in map(int, np.flatnonzero(speeds))
            if not _is_clear(way.parabola(corner, float(speeds[corner]), period)[1], is_free)
        ]
        if not blocked:
            return speeds
        limits[blocked] = 0.0


def _limits(way: StraightPieces, deviation: float) -> FloatArray:
    """What each corner for itself allows."""
    limits = np.zeros(len(way.corners))
    if len(limits) < 3 or deviation <= 0.0:
        return limits
    turns = np.maximum(way.turns[1:-1], 1e-9)
    shorter = np.minimum(way.lengths[:-1], way.lengths[1:])
    limits[1:-1] = np.minimum(way.speeds[:-1], way.speeds[1:])
    limits[1:-1] = np.minimum(limits[1:-1], np.sqrt(8.0 * way.acceleration * deviation) / turns)
    room = np.sqrt(2.0 * way.acceleration * _HALF * shorter / turns)
    limits[1:-1] = np.minimum(limits[1:-1], room)
    return limits


def _reachable(way: StraightPieces, limits: FloatArray) -> FloatArray:
    """The speeds, lowered to what the pieces between the corners allow to reach."""
    speeds, margins = limits.copy(), way.margins(limits)
    gains = 2.0 * way.growths * (way.lengths - margins[:-1] - margins[1:])
    for at in range(1, len(speeds)):
        speeds[at] = min(speeds[at], math.sqrt(speeds[at - 1] ** 2 + gains[at - 1]))
    for at in range(len(speeds) - 2, -1, -1):
        speeds[at] = min(speeds[at], math.sqrt(speeds[at + 1] ** 2 + gains[at]))
    return speeds


def _is_clear(knots: FloatArray, is_free: FreeWay) -> bool:
    return all(is_free(first, second) for first, second in pairwise(knots))
