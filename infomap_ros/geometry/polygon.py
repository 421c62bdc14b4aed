"""Simple polygons in the plane, with signed distance."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike

from infomap_ros.errors import InvalidInputError
from infomap_ros.geometry.transforms import FloatArray

_FLAT = 1e-9  # [m^2]; a polygon of a smaller area is a line


@dataclass(frozen=True)
class Polygon:
    """A closed polygon whose edges meet at its corners only; the last corner joins the first.

    Attributes:
        corners: x, y of each, in either sense of rotation [m].
        name: what it is, for messages.

    Raises:
        InvalidInputError: fewer than three corners, one that is not finite, edges that cross or
            touch, or no area; names the polygon.
    """

    corners: tuple[tuple[float, float], ...]
    name: str = ""

    @classmethod
    def of(cls, corners: Iterable[Iterable[float]], name: str = "") -> Polygon:
        """The polygon of corners, shape (N, 2) [m]; a last one that repeats the first is left out.

        Raises:
            InvalidInputError: as the class, or a corner is not a pair of numbers.
        """
        rows = [tuple(float(value) for value in corner) for corner in corners]
        if any(len(row) != 2 for row in rows):
            raise InvalidInputError(f"polygon '{name}'", "has a corner that is not a pair x, y")
        if len(rows) > 1 and rows[0] == rows[-1]:
            rows.pop()
        return cls(tuple((row[0], row[1]) for row in rows), name)

    def __post_init__(self) -> None:
        what = f"polygon '{self.name}'"
        if len(self.corners) < 3:
            raise InvalidInputError(what, f"has {len(self.corners)} corners, expected at least 3")
        if not np.isfinite(self.corners).all():
            raise InvalidInputError(what, f"has a corner that is not finite: {self.corners}")
        if crossing := self._crossing():
            raise InvalidInputError(what, f"crosses or touches itself: {crossing}")
        if abs(self._area()) < _FLAT:
            raise InvalidInputError(what, "has no area: its corners are in one line")

    def signed_distance(self, points: ArrayLike) -> FloatArray:
        """Distance to the boundary, negative inside; points (..., 2) [m] -> (...) [m]."""
        places = np.asarray(points, dtype=np.float64)
        x, y = places[..., 0], places[..., 1]
        away = np.full(places.shape[:-1], np.inf)
        inside = np.zeros(places.shape[:-1], dtype=bool)
        for (ax, ay), (bx, by) in self._edges():
            dx, dy = bx - ax, by - ay
            along = np.clip(((x - ax) * dx + (y - ay) * dy) / (dx * dx + dy * dy), 0.0, 1.0)
            away = np.minimum(away, np.hypot(x - ax - along * dx, y - ay - along * dy))
            if dy != 0.0:  # edges that a ray along x crosses
                inside ^= ((ay > y) != (by > y)) & (x < ax + (y - ay) * dx / dy)
        return np.where(inside, -away, away)

    def _edges(self) -> list[tuple[tuple[float, float], tuple[float, float]]]:
        return list(pairwise((*self.corners, self.corners[0])))

    def _area(self) -> float:
        """Signed [m^2]: positive where the corners go round counter-clockwise."""
        middle = np.mean(self.corners, axis=0)  # far from the origin products would lose digits
        x, y = (np.array(self.corners) - middle).T
        return 0.5 * float(x @ np.roll(y, -1) - y @ np.roll(x, -1))

    def _crossing(self) -> str:
        """Two edges that have a point in common that they should not have, in words; or empty."""
        edges, count = self._edges(), len(self.corners)
        repeated = next((a for a, b in edges if a == b), None)
        if repeated is not None:
            return f"corner {repeated} is there twice in a row"
        for i, (a, b) in enumerate(edges):
            for j in range(i + 1, count):
                c, d = edges[j]
                if j == i + 1 or (i == 0 and j == count - 1):
                    shared, first, last = (b, a, d) if j == i + 1 else (a, b, c)
                    if count > 3 and _folds_back(shared, first, last):
                        return f"the edges at {shared} lie on each other"
                elif _meet(a, b, c, d):
                    return f"edge {a} to {b} and edge {c} to {d}"
        return ""


_Point = tuple[float, float]


def _turn(a: _Point, b: _Point, c: _Point) -> float:
    """Twice the signed area of a triangle: positive where c lies to the left of a to b."""
    return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])


def _is_between(a: _Point, b: _Point, c: _Point) -> bool:
    """Whether c, in one line with a and b, lies between them."""
    return min(a[0], b[0]) <= c[0] <= max(a[0], b[0]) and min(a[1], b[1]) <= c[1] <= max(a[1], b[1])


def _meet(a: _Point, b: _Point, c: _Point, d: _Point) -> bool:
    """Whether two segments have a point in common."""
    turns = _turn(a, b, c), _turn(a, b, d), _turn(c, d, a), _turn(c, d, b)
    apart = (turns[0] > 0.0) != (turns[1] > 0.0) and (turns[2] > 0.0) != (turns[3] > 0.0)
    if apart and 0.0 not in turns:
        return True
    ends = ((a, b, c), (a, b, d), (c, d, a), (c, d, b))
    return any(t == 0.0 and _is_between(*end) for t, end in zip(turns, ends, strict=True))


def _folds_back(corner: _Point, first: _Point, last: _Point) -> bool:
    """Whether the edges from a corner to two others lie on each other."""
    along = (first[0] - corner[0]) * (last[0] - corner[0])
    along += (first[1] - corner[1]) * (last[1] - corner[1])
    return _turn(corner, first, last) == 0.0 and along > 0.0
