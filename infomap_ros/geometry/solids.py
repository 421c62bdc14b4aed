"""Simple solids with signed distance, for what must be kept apart: bodies, boxes, regions.

Simple polygons in the plane, with signed distance.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from infomap_ros.errors import InvalidInputError
from infomap_ros.geometry.transforms import FloatArray, invert_transform, transform_points


class Solid(Protocol):
    """A closed body in its own frame."""

    @property
    def bounding_radius(self) -> float:
        """Radius of a sphere about the origin of its frame that holds it [m]."""

    def signed_distance(self, points: ArrayLike) -> FloatArray:
        """Distance to the surface, negative inside; points (..., 3) [m] -> (...) [m]."""


def _check_positive(name: str, *values: float) -> None:
    if not all(np.isfinite(value) and value > 0.0 for value in values):
        raise InvalidInputError(name, f"dimensions {values} must be positive")


@dataclass(frozen=True)
class Sphere:
    """Sphere about the origin, `radius` [m]."""

    radius: float

    def __post_init__(self) -> None:
        _check_positive("sphere", self.radius)

    @property
    def bounding_radius(self) -> float:
        return self.radius

    def signed_distance(self, points: ArrayLike) -> FloatArray:
        return np.asarray(np.linalg.norm(np.asarray(points), axis=-1) - self.radius)


@dataclass(frozen=True)
class Box:
    """Axis-aligned box about the origin with edge lengths `size` (x, y, z) [m]."""

    size: tuple[float, float, float]

    def __post_init__(self) -> None:
        _check_positive("box", *self.size)

    @property
    def bounding_radius(self) -> float:
        return 0.5 * float(np.linalg.norm(self.size))

    def signed_distance(self, points: ArrayLike) -> FloatArray:
        beyond = np.abs(np.asarray(points, dtype=np.float64)) - 0.5 * np.asarray(self.size)
        outside = np.linalg.norm(np.maximum(beyond, 0.0), axis=-1)
        return np.asarray(outside + np.minimum(beyond.max(axis=-1), 0.0))


@dataclass(frozen=True)
class Cylinder:
    """Cylinder about the origin along z, `radius` and `length` [m]."""

    radius: float
    length: float

    def __post_init__(self) -> None:
        _check_positive("cylinder", self.radius, self.length)

    @property
    def bounding_radius(self) -> float:
        return float(np.hypot(self.radius, 0.5 * self.length))

    def signed_distance(self, points: ArrayLike) -> FloatArray:
        coordinates = np.asarray(points, dtype=np.float64)
        radial = np.linalg.norm(coordinates[..., :2], axis=-1) - self.radius
        axial = np.abs(coordinates[..., 2]) - 0.5 * self.length
        outside = np.hypot(np.maximum(radial, 0.0), np.maximum(axial, 0.0))
        return np.asarray(outside + np.minimum(np.maximum(radial, axial), 0.0))


@dataclass(frozen=True, eq=False)
class ConvexPolytope:
    """Intersection of half-spaces ``normals @ p <= offsets``.

    Its signed distance is exact inside and a lower bound outside, which errs towards "touches".

    Attributes:
        normals: outward unit normals, shape (n, 3).
        offsets: shape (n,) [m].
        radius: bounding radius about the origin [m].
    """

    normals: FloatArray
    offsets: FloatArray
    radius: float

    @classmethod
    def from_points(cls, points: ArrayLike) -> ConvexPolytope:
        """Convex hull of points, shape (n, 3) [m].

        Raises:
            InvalidInputError: fewer than four points, or all in one plane.
        """
        from scipy.spatial import ConvexHull, QhullError

        vertices = np.asarray(points, dtype=np.float64)
        try:
            hull = ConvexHull(vertices)
        except (QhullError, ValueError) as error:
            raise InvalidInputError("convex hull", str(error).split("\n")[0]) from error
        radius = float(np.linalg.norm(vertices, axis=1).max())
        return cls(hull.equations[:, :3].copy(), -hull.equations[:, 3], radius)

    @property
    def bounding_radius(self) -> float:
        return self.radius

    @cached_property
    def vertices(self) -> FloatArray:
        """Its corners, shape (m, 3) [m]."""
        from scipy.optimize import linprog
        from scipy.spatial import HalfspaceIntersection

        planes, ones = self.normals, np.ones((len(self.normals), 1))
        inscribed = linprog(
            (0.0, 0.0, 0.0, -1.0),
            np.hstack([planes, ones]),
            self.offsets,
            bounds=[(None, None)] * 4,
        )
        halfspaces = np.column_stack([planes, -self.offsets])
        return np.asarray(HalfspaceIntersection(halfspaces, inscribed.x[:3]).intersections)

    def signed_distance(self, points: ArrayLike) -> FloatArray:
        coordinates = np.asarray(points, dtype=np.float64)
        return np.asarray((coordinates @ self.normals.T - self.offsets).max(axis=-1))


@dataclass(frozen=True, eq=False)
class PlacedSolid:
    """A solid with its place in some frame.

    Attributes:
        solid: the body in its own frame.
        transform: ``T_frame_solid``, shape (4, 4).
        name: whose body it is, for messages and pictures.
    """

    solid: Solid
    transform: FloatArray
    name: str = ""


def points_inside(
    points: ArrayLike, solids: Sequence[PlacedSolid], margins: ArrayLike = 0.0
) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
    """Tell which points lie within `margins` of any solid.

    Args:
        points: shape (N, 3) [m], in the frame in which the solids are placed; NaN is outside.
        solids: the bodies.
        margins: growth of the bodies [m], scalar or one per point, shape (N,).

    Returns:
        shape (N,), bool.
    """
    coordinates = np.asarray(points, dtype=np.float64)
    growth = np.broadcast_to(np.asarray(margins, dtype=np.float64), coordinates.shape[:1])
    inside = np.zeros(len(coordinates), dtype=bool)
    for placed in solids:
        offset = coordinates - placed.transform[:3, 3]
        reach = placed.solid.bounding_radius + growth
        with np.errstate(invalid="ignore"):
            near = np.flatnonzero(~inside & (np.einsum("ij,ij->i", offset, offset) <= reach**2))
        if len(near):
            local = transform_points(invert_transform(placed.transform), coordinates[near])
            inside[near] = placed.solid.signed_distance(local) <= growth[near]
    return inside


_FLAT = 1e-9  # [m^2]; a polygon of a smaller area is a line
_SAME = 1e-6  # corners nearer to each other are one [m]
_MOST_CORNERS = 1000  # each pair of edges is compared
_FARTHEST = 1e6  # coordinates keep their micrometers [m]


@dataclass(frozen=True)
class Polygon:
    """A closed polygon whose edges meet at its corners only; the last corner joins the first.

    Attributes:
        corners: x, y of each, in either sense of rotation [m].
        name: what it is, for messages.

    Raises:
        InvalidInputError: fewer than three corners or more than 1000, one that is not finite or
            beyond 1000 km, edges that cross or touch, or no area; names the polygon.
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
        if len(self.corners) > _MOST_CORNERS:
            text = f"has {len(self.corners)} corners, expected at most {_MOST_CORNERS}"
            raise InvalidInputError(what, text)
        if not np.isfinite(self.corners).all():
            raise InvalidInputError(what, f"has a corner that is not finite: {self.corners}")
        if np.abs(self.corners).max() > _FARTHEST:
            raise InvalidInputError(what, f"has a corner farther than {_FARTHEST:g} m away")
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
        for number, (a, b) in enumerate(edges):
            if math.dist(a, b) < _SAME:
                return f"corner {a} is there twice in a row"
            c = edges[(number + 1) % count][1]
            if count > 3 and _folds_back(b, a, c):
                return f"the edges at {b} lie on each other"
        meeting = np.triu(_meeting(np.array(self.corners)), 2)
        meeting[0, -1] = False  # the first edge and the last have a corner in common
        for i, j in np.argwhere(meeting)[:1]:
            (a, b), (c, d) = edges[i], edges[j]
            return f"edge {a} to {b} and edge {c} to {d}"
        return ""


_Point = tuple[float, float]


def _meeting(corners: FloatArray) -> NDArray[np.bool_]:
    """Which two edges of a polygon, shape (n, 2), have a point in common, shape (n, n)."""
    ends = np.roll(corners, -1, axis=0)
    first, last = _turns(corners, corners), _turns(corners, ends)
    apart = (first > 0.0) != (last > 0.0)
    crosses = apart & apart.T & (first != 0.0) & (last != 0.0) & (first.T != 0.0) & (last.T != 0.0)
    touches = (first == 0.0) & _between(corners, corners)
    touches |= (last == 0.0) & _between(corners, ends)
    return np.asarray(crosses | touches | touches.T)


def _turns(corners: FloatArray, points: FloatArray) -> FloatArray:
    """Twice the signed areas of edges (n) with points (m), positive to the left, shape (n, m)."""
    along = np.roll(corners, -1, axis=0) - corners
    to = points[None] - corners[:, None]
    return np.asarray(along[:, None, 0] * to[..., 1] - along[:, None, 1] * to[..., 0])


def _between(corners: FloatArray, points: FloatArray) -> NDArray[np.bool_]:
    """Whether points, in one line with edges, lie between their ends, shape (n, m)."""
    pairs = np.stack([corners, np.roll(corners, -1, axis=0)])
    low, high = pairs.min(axis=0)[:, None], pairs.max(axis=0)[:, None]
    return np.asarray(((low <= points) & (points <= high)).all(axis=-1))


def _turn(a: _Point, b: _Point, c: _Point) -> float:
    """Twice the signed area of a triangle: positive where c lies to the left of a to b."""
    return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])


def _folds_back(corner: _Point, first: _Point, last: _Point) -> bool:
    """Whether the edges from a corner to two others lie on each other."""
    along = (first[0] - corner[0]) * (last[0] - corner[0])
    along += (first[1] - corner[1]) * (last[1] - corner[1])
    return _turn(corner, first, last) == 0.0 and along > 0.0
