"""The scenes of the studies: rays end on the surface that the distance knows."""

from __future__ import annotations

import numpy as np
import pytest

from infomap_ros.geometry import perturb_transform, transform_points
from infomap_ros.studies.noisy_scans import CAMERA, random_scene, random_view, simulate_scans


@pytest.fixture(params=range(4))
def seeded(request) -> np.random.Generator:
    return np.random.default_rng(request.param)


def test_rays_end_where_the_distance_is_first_zero(seeded):
    scene = random_scene(seeded)
    T_map_camera = random_view(scene, seeded)
    directions = seeded.normal(size=(400, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    reached = scene.cast_rays(T_map_camera[:3, 3], directions)
    hits = np.isfinite(reached)
    assert hits.sum() > 100
    for share in np.linspace(0.0, 0.999, 60):
        along = T_map_camera[:3, 3] + share * reached[hits, None] * directions[hits]
        assert (scene.signed_distance(along) > 0.0).all()
    ends = T_map_camera[:3, 3] + reached[hits, None] * directions[hits]
    np.testing.assert_allclose(scene.signed_distance(ends), 0.0, atol=1e-9)
    far = T_map_camera[:3, 3] + np.linspace(0.0, 20.0, 300)[:, None, None] * directions[~hits]
    assert (scene.signed_distance(far.reshape(-1, 3)) > 0.0).all()


def test_depth_image_lies_on_the_surface(seeded):
    scene = random_scene(seeded)
    T_map_camera = random_view(scene, seeded)
    depth = scene.depth_image(T_map_camera, CAMERA)
    points = CAMERA.back_project(depth)[np.isfinite(depth)]
    distance = scene.signed_distance(transform_points(T_map_camera, points))
    np.testing.assert_allclose(distance, 0.0, atol=1e-4)  # rays are float32


def test_normals_are_units_that_point_away(seeded):
    scene = random_scene(seeded)
    points = seeded.uniform(-1, 1, size=(200, 3))
    normals = scene.normals(points)
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1.0)
    step = 1e-4
    rise = scene.signed_distance(points + step * normals) - scene.signed_distance(points)
    assert np.quantile(np.abs(rise / step - 1.0), 0.95) < 1e-2


def test_point_errors_are_those_of_their_covariances(seeded):
    """Squared Mahalanobis distances of 3-D errors have the mean 3."""
    scene = random_scene(seeded)
    state = seeded.bit_generator.state
    (scan,) = simulate_scans(scene, 1, seeded)
    seeded.bit_generator.state = state
    seeded.uniform(size=2)
    truth = CAMERA.back_project(scene.depth_image(random_view(scene, seeded), CAMERA))
    seen = np.isfinite(scan.points).all(axis=-1)
    errors = (scan.points - truth)[seen].astype(np.float64)
    covariances = scan.covariances[seen].astype(np.float64)
    whitened = np.linalg.solve(np.linalg.cholesky(covariances), errors[..., None])
    assert np.mean((whitened**2).sum(axis=(1, 2))) == pytest.approx(3.0, rel=0.05)


def test_pose_errors_are_those_of_their_covariances():
    """The estimate, corrected by the drawn error, is the truth; the errors have the mean NEES 6."""
    squares = []
    for seed in range(150):
        rng = np.random.default_rng(seed)
        scene = random_scene(rng)
        state = rng.bit_generator.state
        (scan,) = simulate_scans(scene, 1, rng)
        rng.bit_generator.state = state
        rng.uniform(size=2)
        truth = random_view(scene, rng)
        rotation = truth[:3, :3] @ scan.pose[:3, :3].T
        turn = 0.5 * np.array(
            [
                rotation[2, 1] - rotation[1, 2],
                rotation[0, 2] - rotation[2, 0],
                rotation[1, 0] - rotation[0, 1],
            ]
        )
        error = np.concatenate([truth[:3, 3] - scan.pose[:3, 3], turn])
        np.testing.assert_allclose(perturb_transform(scan.pose, error), truth, atol=1e-6)
        squares.append(error @ np.linalg.solve(scan.pose_covariance.covariance, error))
    assert 5.4 < np.mean(squares) < 6.6
