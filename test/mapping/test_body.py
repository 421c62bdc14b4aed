"""The body filter against signed distances and sampled bodies."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from infomap_ros.errors import ConfigError, InvalidInputError
from infomap_ros.geometry import (
    Box,
    ConvexPolytope,
    Cylinder,
    PlacedSolid,
    Sphere,
    make_transform,
    points_inside,
    transform_points,
)
from infomap_ros.mapping.scans.body import BodyFilterConfig, body_mask


def make_solid(name: str, rng: np.random.Generator) -> PlacedSolid:
    solid = {
        "sphere": Sphere(0.3),
        "box": Box((0.6, 1.0, 0.3)),
        "cylinder": Cylinder(0.2, 0.9),
        "polytope": ConvexPolytope.from_points(0.3 * rng.normal(size=(30, 3))),
    }[name]
    pose = make_transform(Rotation.random(random_state=rng).as_matrix(), rng.uniform(-1, 1, size=3))
    return PlacedSolid(solid, pose, name)


KINDS = ("sphere", "box", "cylinder", "polytope")


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_equal_errors_in_all_directions_grow_the_solid_evenly(kind, dtype, rng):
    solid = make_solid(kind, rng)
    points = (solid.transform[:3, 3] + rng.uniform(-1, 1, size=(3000, 3))).astype(dtype)
    sigma = rng.uniform(0.0, 0.1, size=3000)
    covariances = (sigma**2)[:, None, None] * np.eye(3)
    mask = body_mask(points, covariances.astype(dtype), [solid], BodyFilterConfig(0.05, 2.0))
    expected = points_inside(points, [solid], 0.05 + 2.0 * sigma)
    assert 100 < expected.sum() < 2900
    assert (mask != expected).sum() <= 1  # a float32 point may lie on the border itself


def test_many_solids_agree_with_one_at_a_time(rng):
    solids = [make_solid(kind, rng) for kind in KINDS for _ in range(4)]
    points = rng.uniform(-2, 2, size=(5000, 3))
    config = BodyFilterConfig(margin=0.03, sigmas=0.0)
    mask = body_mask(points, None, solids, config)
    np.testing.assert_array_equal(mask, points_inside(points, solids, 0.03))


def body_samples(solid: PlacedSolid, margin: float, rng: np.random.Generator) -> np.ndarray:
    """Points of the solid grown by the margin."""
    radius = solid.solid.bounding_radius + margin
    samples = rng.uniform(-radius, radius, size=(40000, 3))
    samples = samples[solid.solid.signed_distance(samples) <= margin]
    return transform_points(solid.transform, samples)


@pytest.mark.parametrize("kind", KINDS)
def test_whatever_an_error_can_have_carried_off_the_body_is_marked(kind, rng):
    """Elongated covariances, as stereo has them: no point within k sigma of the body stays."""
    solid, margin, sigmas = make_solid(kind, rng), 0.02, 2.0
    body = body_samples(solid, margin, rng)
    points = solid.transform[:3, 3] + rng.uniform(-0.7, 0.7, size=(300, 3))
    factors = rng.normal(size=(300, 3, 3)) @ np.diag([0.15, 0.02, 0.01])
    covariances = factors @ factors.transpose(0, 2, 1)
    reached = []
    for point, covariance in zip(points, covariances, strict=True):
        whitened = np.linalg.solve(np.linalg.cholesky(covariance), (body - point).T)
        reached.append((whitened**2).sum(axis=0).min() <= sigmas**2)
    mask = body_mask(points, covariances, [solid], BodyFilterConfig(margin, sigmas))
    assert 20 < sum(reached) < 280
    assert mask[reached].all()


@pytest.mark.parametrize("kind", ["sphere", "box", "cylinder"])
def test_growth_is_the_deviation_along_the_direction_from_the_body(kind, rng):
    """The direction is the gradient of the signed distance, by finite differences."""
    solid, step = make_solid(kind, rng), 1e-6
    points = rng.uniform(-1.2, 1.2, size=(2000, 3))
    factors = rng.normal(size=(2000, 3, 3)) @ np.diag([0.1, 0.02, 0.01])
    covariances = factors @ factors.transpose(0, 2, 1)
    distance = solid.solid.signed_distance
    gradient = np.stack(
        [
            (distance(points + step * e) - distance(points - step * e)) / (2 * step)
            for e in np.eye(3)
        ],
        axis=-1,
    )
    in_frame = gradient @ solid.transform[:3, :3].T
    sigma = np.sqrt(np.einsum("ni,nij,nj->n", in_frame, covariances, in_frame))
    expected = (distance(points) <= 0.02 + 2.5 * sigma) | (distance(points) <= 0.0)
    placed = transform_points(solid.transform, points)
    mask = body_mask(placed, covariances, [solid], BodyFilterConfig(0.02, 2.5))
    assert 100 < expected.sum() < 1900
    assert (mask != expected).sum() <= 1  # finite differences blur the edges of a box


@pytest.mark.parametrize("kind", KINDS)
def test_points_that_would_be_seen_through_the_body_are_marked(kind, rng):
    """Against places along each ray, at each of which the signed distance is asked."""
    config, marked = BodyFilterConfig(0.02, 0.0), 0
    along = np.linspace(0.0, 1.0, 2001)[:, None, None]
    for _ in range(5):
        solid = make_solid(kind, rng)
        solid.transform[:3, 3] *= 1.5 / np.linalg.norm(solid.transform[:3, 3])
        points = 1.5 * solid.transform[:3, 3] + rng.uniform(-1.2, 1.2, size=(300, 3))
        mask = body_mask(points, None, [solid], config, rays=True)
        places, shape = (along * points).reshape(-1, 3), (len(along), len(points))
        inside = points_inside(places, [solid], 0.01).reshape(shape).any(axis=0)
        assert mask[inside].all()
        # At its edges what is grown by its faces reaches beyond the distance.
        sharp = {"sphere": 0.021, "box": 0.035, "cylinder": 0.029, "polytope": 0.3}[kind]
        near = points_inside(places, [solid], sharp).reshape(shape).any(axis=0)
        assert not mask[~near].any()
        assert (mask & ~body_mask(points, None, [solid], config)).sum() > 10
        marked += int(inside.sum())
    assert 100 < marked < 1300


def test_a_camera_sees_out_of_the_housing_that_holds_it():
    housing = PlacedSolid(Box((0.2, 0.1, 0.1)), make_transform(np.eye(3), [0.0, 0.0, -0.03]))
    wrist = PlacedSolid(Box((0.2, 0.2, 0.2)), make_transform(np.eye(3), [0.0, 0.0, -0.101]))
    points = np.array([[0.0, 0.0, 1.0], [2.0, 0.1, 0.5], [0.0, 0.0, -1.0]])
    mask = body_mask(points, None, [housing, wrist], BodyFilterConfig(0.02, 0.0), rays=True)
    np.testing.assert_array_equal(mask, [False, False, True])


def test_point_beside_the_body_stays_though_its_depth_is_uncertain():
    solid = PlacedSolid(Sphere(0.1), make_transform(np.eye(3), [0.0, 0.0, 1.0]))
    depth_only = np.diag([1e-6, 1e-6, 0.04])
    mask = body_mask(
        [[0.3, 0.0, 1.0], [0.0, 0.0, 1.3]], [depth_only, depth_only], [solid], BodyFilterConfig()
    )
    np.testing.assert_array_equal(mask, [False, True])


def test_organized_cloud_keeps_its_shape_and_missing_points_stay(rng):
    solid = PlacedSolid(Sphere(0.5), np.eye(4))
    points = np.full((4, 5, 3), np.nan, dtype=np.float32)
    points[1, 2] = 0.0
    points[3, 3] = np.inf
    mask = body_mask(points, np.tile(np.eye(3), (4, 5, 1, 1)), [solid])
    assert mask.shape == (4, 5)
    assert np.flatnonzero(mask).tolist() == [7]


def test_six_numbers_of_a_covariance_are_as_good_as_nine(rng):
    solids = [make_solid(kind, rng) for kind in KINDS]
    points = rng.uniform(-2, 2, size=(2000, 3))
    factors = 0.1 * rng.normal(size=(2000, 3, 3))
    covariances = factors @ factors.transpose(0, 2, 1)
    upper = covariances[:, [0, 0, 0, 1, 1, 2], [0, 1, 2, 1, 2, 2]]
    full = body_mask(points, covariances, solids)
    np.testing.assert_array_equal(body_mask(points, upper, solids), full)
    assert full.any()


@pytest.mark.parametrize(
    "unknown", [None, np.full((2, 3, 3), np.nan), -np.eye(3) * np.ones((2, 1, 1))]
)
def test_unknown_covariance_is_not_taken_for_zero(unknown):
    solid = PlacedSolid(Sphere(0.1), np.eye(4))
    config = BodyFilterConfig(margin=0.0, sigmas=2.0, default_sigma=0.05)
    mask = body_mask([[0.19, 0.0, 0.0], [0.21, 0.0, 0.0]], unknown, [solid], config)
    np.testing.assert_array_equal(mask, [True, False])


def test_without_a_body_nothing_is_marked(rng):
    assert not body_mask(rng.normal(size=(9, 3)), None, []).any()


@pytest.mark.parametrize(
    ("points", "covariances", "named"),
    [
        (np.zeros((4, 2)), None, "points"),
        (np.zeros((4, 3)), np.zeros((3, 3, 3)), "covariances"),
        (np.zeros((4, 3)), np.zeros((4, 5)), "covariances"),
    ],
)
def test_shapes_that_do_not_fit_are_refused(points, covariances, named):
    with pytest.raises(InvalidInputError, match=named):
        body_mask(points, covariances, [PlacedSolid(Sphere(1.0), np.eye(4))])


def test_unknown_solid_is_refused():
    class Cone:
        bounding_radius = 1.0

        def signed_distance(self, points):
            return np.zeros(len(points))

    with pytest.raises(InvalidInputError, match=r"'hat'.*Cone"):
        body_mask(np.zeros((4, 3)), None, [PlacedSolid(Cone(), np.eye(4), "hat")])


@pytest.mark.parametrize("change", [{"margin": -0.01}, {"sigmas": 7.0}, {"default_sigma": np.nan}])
def test_impossible_config_is_refused(change):
    with pytest.raises(ConfigError, match=next(iter(change))):
        BodyFilterConfig(**change)
