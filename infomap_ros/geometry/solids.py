"""Simple solids with signed distance, for what must be kept apart: bodies, boxes, regions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike

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
