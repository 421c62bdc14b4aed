"""Polygons against a slow oracle, and those that are none."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise

import numpy as np
import pytest

from infomap_ros.errors import InvalidInputError
from infomap_ros.geometry import Polygon

NAN, INF = float("nan"), float("inf")


def winds_around(point: Sequence[float], corners: Sequence[Sequence[float]]) -> bool:
    """Whether a polygon winds around a point: the angles between its corners sum up to a turn."""
    total = 0.0
    for n, (ax, ay) in enumerate(corners):
        bx, by = corners[(n + 1) % len(corners)]
        first = math.atan2(ay - point[1], ax - point[0])
        second = math.atan2(by - point[1], bx - point[0])
        total += math.remainder(second - first, 2.0 * math.pi)
    return abs(total) > math.pi


def star(rng: np.random.Generator, corners: int) -> Polygon:
    """A polygon that is seen whole from its middle, mostly not convex."""
    angles = np.sort(rng.uniform(0.0, 2.0 * np.pi, corners))
    angles = np.linspace(0.0, 2.0 * np.pi, corners, endpoint=False) + 0.3 * np.sin(angles)
    radii = rng.uniform(0.4, 2.0, corners)
    return Polygon.of(np.column_stack([radii * np.cos(angles), radii * np.sin(angles)]), "star")


def to_boundary(point: np.ndarray, polygon: Polygon) -> float:
    """Distance to many points of the boundary."""
    corners = np.array([*polygon.corners, polygon.corners[0]])
    along = np.linspace(0.0, 1.0, 2001)[:, None]
    edges = [a + along * (b - a) for a, b in pairwise(corners)]
    return float(np.linalg.norm(np.concatenate(edges) - point, axis=1).min())


@pytest.mark.parametrize("seed", range(6))
def test_distance_and_side_are_those_of_the_oracle(seed: int) -> None:
    rng = np.random.default_rng(seed)
    polygon = star(rng, int(rng.integers(3, 12)))
    points = rng.uniform(-2.2, 2.2, (200, 2))
    distances = polygon.signed_distance(points)
    inside = [winds_around(point, polygon.corners) for point in points]
    np.testing.assert_array_equal(distances < 0.0, inside)
    away = [to_boundary(point, polygon) for point in points]
    np.testing.assert_allclose(np.abs(distances), away, atol=2e-3)
    assert 10 < sum(inside) < 190


def test_the_sense_of_rotation_and_a_repeated_first_corner_do_not_matter() -> None:
    corners = [(0.0, 0.0), (2.0, 0.0), (2.0, 1.0), (1.0, 0.4), (0.0, 1.0)]
    polygon, points = Polygon.of(corners), np.random.default_rng(1).uniform(-1.0, 3.0, (50, 2))
    for other in (Polygon.of(corners[::-1]), Polygon.of([*corners, corners[0]])):
        np.testing.assert_allclose(other.signed_distance(points), polygon.signed_distance(points))


@pytest.mark.parametrize(
    ("corners", "problem"),
    [
        ([], "0 corners"),
        ([(0, 0), (1, 0)], "2 corners"),
        ([(0, 0), (1, 0), (0, 0)], "2 corners"),
        ([(0, 0), (1, 0), (1, NAN)], "not finite"),
        ([(0, 0), (1, 0), (1, -INF)], "not finite"),
        ([(0, 0), (1, 1), (1, 0), (0, 1)], "crosses or touches itself"),
        ([(0, 0), (4, 0), (4, 2), (2, 0), (0, 2)], "crosses or touches itself"),
        ([(0, 0), (2, 0), (1, 0), (1, 1)], "crosses or touches itself"),
        ([(0, 0), (1, 0), (1, 0), (0, 1)], "twice in a row"),
        ([(0, 0), (1, 1), (2, 2)], "no area"),
        ([(0, 0), (1, 0, 0), (1, 1)], "not a pair"),
        ([(0, 0), (1e-170, 0), (1, 1)], "twice in a row"),
        ([(0, 0), (1e160, 0), (1, 1)], "farther than"),
        ([(n, n % 2) for n in range(20_000)], "20000 corners"),
    ],
)
def test_what_is_no_polygon_is_refused_by_name(corners: list, problem: str) -> None:
    with pytest.raises(InvalidInputError, match=problem) as caught:
        Polygon.of(corners, "stairs")
    assert caught.value.name == "polygon 'stairs'"


def test_crossing_edges_are_found_wherever_they_are(rng: np.random.Generator) -> None:
    """A star with rays at all angles is simple; with two of its corners exchanged it is not."""
    angles = np.sort(rng.uniform(0.0, 2.0 * np.pi, 60))
    star = rng.uniform(1.0, 2.0, 60)[:, None] * np.column_stack([np.cos(angles), np.sin(angles)])
    assert len(Polygon.of(star.tolist(), "star").corners) == 60
    for first in (3, 20, 50):
        crossed = star.copy()
        crossed[[first, first + 7]] = crossed[[first + 7, first]]
        with pytest.raises(InvalidInputError, match="crosses or touches itself"):
            Polygon.of(crossed.tolist(), "star")
