"""How places off the graph are joined to it, and nodes to each other: turns or curves."""

from __future__ import annotations

import math
from itertools import pairwise
from typing import Any

import numpy as np
from ompl import base as ob

from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.motion.base.base_path import BasePlannerConfig
from infomap_ros.motion.base.drive_arcs import arc_points
from infomap_ros.motion.base.drive_points import drive_cost

_IN_PLACE = 1e-3  # [m]; radius at which the curves of Reeds and Shepp are turns in place


class Turns:
    """A vehicle that turns in place: turn, drive straight, turn.

    Attributes:
        reach: distance of nodes by which a place joins the graph [m].
    """

    def __init__(self, config: BasePlannerConfig, edge: float) -> None:
        self._config = config
        self.reach = edge

    def cost(self, a: FloatArray, b: FloatArray) -> float:
        """Cost of the way from a to b, shape (3,) each [m]."""
        return float(drive_cost(a, b, self._config.reverse, self._config.turn_cost))

    def join(self, a: FloatArray, b: FloatArray) -> FloatArray:
        """The way from a to b, both included, shape (K, 3)."""
        return np.stack([a, b])

    def chain(self, places: FloatArray) -> FloatArray:
        """The way through nodes that follow each other in the graph, shape (N, 3) -> (K, 3)."""
        return places

    def state_space(self) -> Any:
        """OMPL's space of these ways, without bounds: curves whose radius vanishes."""
        return _curves(_IN_PLACE, self._config.reverse)


class Curves:
    """A vehicle with a smallest radius: the curves of Reeds and Shepp, or of Dubins forwards.

    https://doi.org/10.2140/pjm.1990.145.367, https://doi.org/10.2307/2372560
    """

    def __init__(self, config: BasePlannerConfig, edge: float) -> None:
        self._spacing, self._turn_cost = edge, config.turn_cost / config.turning_radius
        self._radius, self._reverse = config.turning_radius, config.reverse
        self._space = self.state_space()
        bounds = ob.RealVectorBounds(2)
        bounds.setLow(-1e6)
        bounds.setHigh(1e6)
        self._space.setBounds(bounds)
        self.reach = 1.5 * config.turning_radius + edge

    def cost(self, a: FloatArray, b: FloatArray) -> float:
        """See `Turns`; as if all of it were curved."""
        distance = float(self._space.distance(self._state(a), self._state(b)))
        return distance * (1.0 + self._turn_cost)

    def join(self, a: FloatArray, b: FloatArray) -> FloatArray:
        """See `Turns`."""
        first, last, between = self._state(a), self._state(b), self._space.allocState()
        count = max(1, math.ceil(self._space.distance(first, last) / self._spacing))
        way = np.empty((count + 1, 3))
        for n in range(count + 1):
            self._space.interpolate(first, last, n / count, between)
            way[n] = between.getX(), between.getY(), between.getYaw()
        return way

    def chain(self, places: FloatArray) -> FloatArray:
        """See `Turns`."""
        parts = [arc_points(a, b, self._spacing)[1:] for a, b in pairwise(places)]
        return np.concatenate([places[:1], *parts])

    def state_space(self) -> Any:
        """See `Turns`."""
        return _curves(self._radius, self._reverse)

    def _state(self, place: FloatArray) -> Any:
        return state_of(self._space, place)


def _curves(radius: float, reverse: bool) -> Any:
    """OMPL's space of the shortest curves of a radius [m]."""
    return (ob.ReedsSheppStateSpace if reverse else ob.DubinsStateSpace)(radius)


def state_of(space: Any, place: FloatArray) -> Any:
    """OMPL's state of x, y, yaw, shape (3,), in a space."""
    state = space.allocState()
    state.setXY(float(place[0]), float(place[1]))
    state.setYaw(float((place[2] + np.pi) % (2.0 * np.pi) - np.pi))
    return state


Links = Turns | Curves
"""Ways between two places for one kind of vehicle."""


def links_for(config: BasePlannerConfig, edge: float) -> Links:
    """Links of the vehicle that a configuration describes, for cells of this edge [m]."""
    return Turns(config, edge) if config.turning_radius == 0.0 else Curves(config, edge)
