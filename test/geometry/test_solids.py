"""Solids against dense samples of their surfaces and naive membership."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial import Delaunay, KDTree
from scipy.spatial.transform import Rotation

from infomap_ros.errors import InvalidInputError
from infomap_ros.geometry import (
    Box,
    ConvexPolytope,
    Cylinder,
    PlacedSolid,
    Sphere,
    make_transform,
    points_inside,
)

STEP = 0.01  # spacing of the surface samples [m]


def grid(low: float, high: float) -> np.ndarray:
    return np.linspace(low, high, int(np.ceil((high - low) / STEP)) + 1)


def box_surface(size: tuple[float, float, float]) -> np.ndarray:
    half = 0.5 * np.asarray(size)
    faces = []
    for axis in range(3):
        others = [i for i in range(3) if i != axis]
        a, b = np.meshgrid(*(grid(-half[i], half[i]) for i in others), indexing="ij")
        for side in (-1.0, 1.0):
            face = np.empty((a.size, 3))
            face[:, others[0]], face[:, others[1]] = a.ravel(), b.ravel()
            face[:, axis] = side * half[axis]
            faces.append(face)
    return np.concatenate(faces)


def cylinder_surface(radius: float, length: float) -> np.ndarray:
    angle, z = np.meshgrid(grid(0.0, 2 * np.pi), grid(-length / 2, length / 2))
    wall = np.stack([radius * np.cos(angle), radius * np.sin(angle), z], -1).reshape(-1, 3)
    x, y = np.meshgrid(grid(-radius, radius), grid(-radius, radius))
    disc = np.stack([x, y], -1).reshape(-1, 2)
    disc = disc[np.linalg.norm(disc, axis=1) <= radius]
    caps = [np.column_stack([disc, np.full(len(disc), s * length / 2)]) for s in (-1, 1)]
    return np.concatenate([wall, *caps])


@pytest.mark.parametrize(
    ("solid", "surface"),
    [
        (Box((0.6, 1.0, 0.3)), box_surface((0.6, 1.0, 0.3))),
        (Cylinder(0.4, 0.9), cylinder_surface(0.4, 0.9)),
    ],
)
def test_distance_is_that_to_the_nearest_surface_sample(solid, surface, rng):
    points = rng.uniform(-1.2, 1.2, size=(2000, 3))
    nearest, _ = KDTree(surface).query(points)
    distance = solid.signed_distance(points)
    np.testing.assert_array_less(np.abs(nearest - np.abs(distance)), STEP)


def test_box_distance_is_negative_exactly_inside(rng):
    points = rng.uniform(-1.0, 1.0, size=(2000, 3))
    inside = (np.abs(points) < [0.3, 0.5, 0.15]).all(axis=1)
    assert inside.any()
    np.testing.assert_array_equal(Box((0.6, 1.0, 0.3)).signed_distance(points) < 0.0, inside)


def test_cylinder_distance_is_negative_exactly_inside(rng):
    points = rng.uniform(-1.0, 1.0, size=(2000, 3))
    inside = (points[:, 0] ** 2 + points[:, 1] ** 2 < 0.16) & (np.abs(points[:, 2]) < 0.45)
    np.testing.assert_array_equal(Cylinder(0.4, 0.9).signed_distance(points) < 0.0, inside)


def test_sphere_distance(rng):
    points = rng.normal(size=(3, 4, 3))
    expected = np.sqrt((points**2).sum(-1)) - 0.7
    np.testing.assert_allclose(Sphere(0.7).signed_distance(points), expected, atol=1e-15)


def test_polytope_membership_agrees_with_a_triangulation(rng):
    vertices = rng.normal(size=(30, 3))
    points = rng.normal(size=(2000, 3))
    inside = Delaunay(vertices).find_simplex(points) >= 0
    assert inside.any()
    polytope = ConvexPolytope.from_points(vertices)
    np.testing.assert_array_equal(polytope.signed_distance(points) <= 0.0, inside)


def test_polytope_distance_is_exact_inside_and_a_lower_bound_outside(rng):
    size = (0.6, 1.0, 0.3)
    corners = 0.5 * np.array(size) * np.array(np.meshgrid(*[[-1, 1]] * 3)).reshape(3, -1).T
    polytope, box = ConvexPolytope.from_points(corners), Box(size)
    points = rng.uniform(-1.0, 1.0, size=(2000, 3))
    truth, distance = box.signed_distance(points), polytope.signed_distance(points)
    np.testing.assert_allclose(distance[truth < 0], truth[truth < 0], atol=1e-12)
    assert (distance[truth > 0] > 0).all()
    assert (distance <= truth + 1e-12).all()


@pytest.mark.parametrize(
    "points",
    [np.eye(3), np.random.default_rng(0).normal(size=(9, 3)) * [1, 1, 0], np.full((9, 3), np.nan)],
)
def test_points_without_a_volume_have_no_hull(points):
    with pytest.raises(InvalidInputError, match="convex hull"):
        ConvexPolytope.from_points(points)


@pytest.mark.parametrize(
    "make",
    [
        lambda: Sphere(0.0),
        lambda: Box((1.0, -1.0, 1.0)),
        lambda: Cylinder(1.0, np.nan),
        lambda: Cylinder(np.inf, 1.0),
    ],
)
def test_impossible_dimensions_are_refused(make):
    with pytest.raises(InvalidInputError, match="positive"):
        make()


@pytest.mark.parametrize(
    "solid", [Sphere(0.4), Box((0.6, 1.0, 0.3)), Cylinder(0.4, 0.9), "polytope"]
)
def test_bounding_sphere_holds_the_solid(solid, rng):
    if solid == "polytope":
        solid = ConvexPolytope.from_points(rng.normal(size=(30, 3)))
    points = rng.uniform(-4.0, 4.0, size=(20000, 3))
    inside = solid.signed_distance(points) <= 0.0
    assert inside.any()
    assert np.linalg.norm(points[inside], axis=1).max() <= solid.bounding_radius


def scattered_solids(rng: np.random.Generator) -> list[PlacedSolid]:
    solids = [Sphere(0.3), Box((0.6, 1.0, 0.3)), Cylinder(0.2, 0.9)]
    solids.append(ConvexPolytope.from_points(0.3 * rng.normal(size=(30, 3))))
    return [
        PlacedSolid(
            s,
            make_transform(
                Rotation.random(random_state=rng).as_matrix(), rng.uniform(-1, 1, size=3)
            ),
        )
        for s in solids
    ]


def test_points_inside_agrees_with_one_point_at_a_time(rng):
    solids = scattered_solids(rng)
    points = rng.uniform(-1.2, 1.2, size=(500, 3))
    margins = rng.uniform(0.0, 0.3, size=500)
    expected = [
        any(
            s.solid.signed_distance((np.linalg.inv(s.transform) @ [*p, 1.0])[:3]) <= margin
            for s in solids
        )
        for p, margin in zip(points, margins, strict=True)
    ]
    assert 20 < sum(expected) < 480
    np.testing.assert_array_equal(points_inside(points, solids, margins), expected)


def test_missing_points_are_outside(rng):
    points = np.array([[np.nan, 0.0, 0.0], [0.0, 0.0, 0.0], [np.inf, 0.0, 0.0]])
    inside = points_inside(points, [PlacedSolid(Sphere(1.0), np.eye(4))])
    np.testing.assert_array_equal(inside, [False, True, False])


def test_without_solids_nothing_is_inside(rng):
    assert not points_inside(rng.normal(size=(5, 3)), []).any()
