"""A way of the base, and which teammates have come nearer to it than they were."""

from __future__ import annotations

import math

import numpy as np

from infomap_ros.exploration.robot import Interrupted, Motion, Robot
from infomap_ros.exploration.team.awareness import NEARER, Awareness, who_and_how_near
from infomap_ros.geometry.transforms import FloatArray

_SPACING = 0.05  # of the places of the way that are looked at [m]


class WatchedDrive:
    """The rest of a way of the base. Bodies are taken for upright cylinders.

    Args:
        robot: that drives.
        around: what it knows on the way.
        way: base poses (x, y, yaw), shape (K, 3) [m, rad, map].
        ahead: length of the part ahead that is looked at [m].
    """

    def __init__(self, robot: Robot, around: Awareness, way: FloatArray, ahead: float) -> None:
        self._robot, self._around, self._ahead = robot, around, ahead
        self._way, self._has_begun = way, False
        self._planned = self._distances(way)

    def go_on(self, interrupted: Interrupted) -> Motion:
        """Drive what is left of the way."""
        if self._has_begun:
            self._way = self._rest()
        self._has_begun = True
        return self._robot.drive(self._way, interrupted)

    def in_the_way(self, distance: float) -> list[str]:
        """Who is nearer than a distance [m] to the way ahead, and came nearer, in words."""
        mates = self._around.teammates()
        if not mates:
            return []
        here = np.array(self._around.place()[:2])
        ahead, own = self._places_ahead(here), self._around.radius()
        found = []
        for mate in mates:
            there = mate.T_map_base[:2, 3]
            nearest = float(np.linalg.norm(ahead - there, axis=1).min())
            now = float(np.linalg.norm(here - there))
            came = nearest < self._planned.get(mate.robot, np.inf) - NEARER
            gap = nearest - own - mate.reach
            if came and nearest <= now and gap < distance:
                found.append(who_and_how_near(mate, gap))
        return found

    def _distances(self, way: FloatArray) -> dict[int, float]:
        """How far each teammate is from a way now [m]."""
        places = _spaced(way[:, :2], np.inf)
        return {
            mate.robot: float(np.linalg.norm(places - mate.T_map_base[:2, 3], axis=1).min())
            for mate in self._around.teammates()
        }

    def _places_ahead(self, here: FloatArray) -> FloatArray:
        """Places on the next part of the way, the own one first, shape (n, 2) [m]."""
        way = self._way
        nearest = int(np.linalg.norm(way[:, :2] - here, axis=1).argmin())
        return _spaced(np.concatenate([here[None], way[nearest + 1 :, :2]]), self._ahead)

    def _rest(self) -> FloatArray:
        """The way from where the robot is, shape (K, 3)."""
        here, way = np.array(self._around.place()), self._way
        nearest = int(np.linalg.norm(way[:, :2] - here[:2], axis=1).argmin())
        return np.concatenate([here[None], way[min(nearest + 1, len(way) - 1) :]])


def _spaced(places: FloatArray, length: float) -> FloatArray:
    """The first part of a way through places, (K, 2), by points at most `_SPACING` apart."""
    steps = np.linalg.norm(np.diff(places, axis=0), axis=1)
    along = np.concatenate([[0.0], np.cumsum(steps)])
    end = min(float(along[-1]), length)
    at = np.linspace(0.0, end, math.ceil(end / _SPACING) + 1)
    return np.column_stack([np.interp(at, along, places[:, axis]) for axis in range(2)])
