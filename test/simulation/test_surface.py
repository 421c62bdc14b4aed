from __future__ import annotations

import numpy as np
import pytest

from infomap_ros.errors import InvalidInputError
from infomap_ros.geometry import Box
from infomap_ros.simulation.worlds.rocks import icosphere
from infomap_ros.simulation.worlds.surface import SurfaceModel, SurfacePart

CORNERS = np.array([(x, y, z) for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)])
FACES = np.array(
    [
        [0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1],
        [2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3],
    ]
)  # fmt: skip


def naive_distance(point: np.ndarray, triangle: np.ndarray) -> float:
    """Foot of the perpendicular if it is inside, else the nearest of three segments."""
    a, b, c = triangle
    normal = np.cross(b - a, c - a)
    foot = point - normal * np.dot(point - a, normal) / np.dot(normal, normal)
    sides = [np.dot(np.cross(q - p, foot - p), normal) for p, q in ((a, b), (b, c), (c, a))]
    if min(sides) >= 0.0:
        return float(np.linalg.norm(point - foot))
    best = np.inf
    for p, q in ((a, b), (b, c), (c, a)):
        t = np.clip(np.dot(point - p, q - p) / np.dot(q - p, q - p), 0.0, 1.0)
        best = min(best, float(np.linalg.norm(point - p - t * (q - p))))
    return best


@pytest.mark.parametrize("cell", [0.05, 0.3, 5.0])
def test_distance_equals_the_naive_one(cell: float, rng: np.random.Generator) -> None:
    centers = rng.uniform(-1.0, 1.0, (40, 1, 3))
    triangles = centers + rng.normal(0.0, 0.2, (40, 3, 3))
    part = SurfacePart("soup", triangles.reshape(-1, 3), np.arange(120).reshape(-1, 3))
    points = rng.uniform(-3.0, 3.0, (200, 3))
    expected = [min(naive_distance(p, t) for t in triangles) for p in points]
    actual = SurfaceModel([part], cell).distance(points)
    np.testing.assert_allclose(actual, expected, rtol=0.0, atol=1e-12)


def test_box_distance_equals_the_solids(rng: np.random.Generator) -> None:
    size = np.array((1.0, 0.6, 0.3))
    model = SurfaceModel([SurfacePart("box", CORNERS * size, FACES)])
    points = rng.uniform(-1.0, 1.0, (500, 3))
    expected = np.abs(Box((1.0, 0.6, 0.3)).signed_distance(points))
    np.testing.assert_allclose(model.distance(points), expected, atol=1e-12)


def test_closest_point_normal_and_part(rng: np.random.Generator) -> None:
    vertices, faces = icosphere(4)
    ball = SurfacePart("ball", vertices + np.array((3.0, 0.0, 0.0)), faces)
    model = SurfaceModel([SurfacePart("box", CORNERS, FACES), ball])
    directions = rng.normal(size=(50, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    match = model.closest(directions * 1.2 + (3.0, 0.0, 0.0))
    outside = match.parts == model.names.index("ball")
    assert outside.sum() > 40
    np.testing.assert_allclose(match.distances[outside], 0.2, atol=4e-3)
    cosine = np.einsum("ij,ij->i", match.normals, directions)[outside]
    assert cosine.min() > 0.99


def test_nan_points_stay_nan() -> None:
    model = SurfaceModel([SurfacePart("box", CORNERS, FACES)])
    match = model.closest([(np.nan, 0.0, 0.0), (0.0, 0.0, 0.7)])
    assert np.isnan(match.distances[0])
    assert match.parts[0] == -1
    assert np.isnan(match.normals[0]).all()
    assert match.distances[1] == pytest.approx(0.2)


def test_wrong_shapes_are_refused() -> None:
    with pytest.raises(InvalidInputError, match=r"\(N, 3\)"):
        SurfaceModel([SurfacePart("box", CORNERS, FACES)]).distance(np.zeros((2, 2)))
    with pytest.raises(InvalidInputError, match="finite"):
        SurfaceModel([])
