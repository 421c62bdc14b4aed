"""Covers hold their solids and stay near them, by dense sampling."""

from __future__ import annotations

import numpy as np
import pytest

from infomap_ros.errors import InvalidInputError
from infomap_ros.geometry import Box, ConvexPolytope, Cylinder, Solid, Sphere
from infomap_ros.motion.collision.body import cover_by_spheres

SOLIDS = [
    Sphere(0.026),
    Box((0.4, 0.226, 0.1)),
    Box((0.3, 0.2, 0.001)),
    Cylinder(0.021, 0.3442),
    Cylinder(0.0762, 0.064),
    ConvexPolytope.from_points(
        np.random.default_rng(3).normal(size=(30, 3)) * np.array((0.05, 0.03, 0.02))
    ),
]


@pytest.mark.parametrize("solid", SOLIDS, ids=lambda solid: type(solid).__name__)
@pytest.mark.parametrize("tolerance", [0.01, 0.03])
def test_solid_is_in_its_cover(solid: Solid, tolerance: float, rng: np.random.Generator) -> None:
    cover = cover_by_spheres(solid, tolerance)
    points = rng.uniform(-1, 1, (200_000, 3)) * solid.bounding_radius
    if isinstance(solid, Box):
        points = rng.uniform(-0.5, 0.5, (20_000, 3)) * np.array(solid.size)
    inside = points[solid.signed_distance(points) <= 0.0][:4000]
    assert len(inside) > 100
    distances = np.linalg.norm(inside[:, None] - cover[:, :3], axis=2) - cover[:, 3]
    assert distances.min(axis=1).max() <= 0.0


@pytest.mark.parametrize("solid", SOLIDS, ids=lambda solid: type(solid).__name__)
def test_cover_does_not_stick_out_farther_than_the_tolerance(
    solid: Solid, rng: np.random.Generator
) -> None:
    cover = cover_by_spheres(solid, 0.02)
    directions = rng.normal(size=(2000, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    for *center, radius in cover:
        outside = solid.signed_distance(np.array(center) + radius * directions)
        assert outside.max() <= 0.02 + 1e-6


def test_cover_of_a_sphere_is_itself() -> None:
    np.testing.assert_array_equal(cover_by_spheres(Sphere(0.3), 0.01), [[0, 0, 0, 0.3]])


def test_large_solid_needs_a_bounded_number_of_spheres(rng: np.random.Generator) -> None:
    box = Box((3.0, 2.0, 1.0))
    cover = cover_by_spheres(box, 0.01)
    assert len(cover) < 2000
    points = rng.uniform(-0.5, 0.5, (5000, 3)) * np.array(box.size)
    distances = np.linalg.norm(points[:, None] - cover[:, :3], axis=2) - cover[:, 3]
    assert distances.min(axis=1).max() <= 0.0


def test_tolerance_must_be_positive() -> None:
    with pytest.raises(InvalidInputError, match="tolerance"):
        cover_by_spheres(Box((1, 1, 1)), 0.0)
