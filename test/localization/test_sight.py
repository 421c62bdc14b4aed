"""The correction by one image, against naive dense algebra and finite differences."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from infomap_ros.localization.filter.lie import exponential, left_jacobian, logarithm
from infomap_ros.localization.filter.sight import Measured, Sight, correct, innovations_from
from test.localization.fiducial_scene import CAMERA, observe, wall


def some_sight(rng: np.random.Generator, count: int = 7, without_range: int = 2) -> Sight:
    points = wall(count, rng)
    observations = observe(points, np.eye(4), rng)
    inverse = observations.inverse_depths.copy()
    inverse[:without_range] = np.nan
    measured = Measured.of(
        CAMERA, type(observations)(
            observations.ids, observations.pixels, observations.pixel_sigmas, inverse,
            observations.inverse_depth_sigmas,
        )
    )  # fmt: skip
    root = 0.01 * rng.normal(size=(3 * count + 3, 3 * count + 3))
    joint = root @ root.T
    mean = root @ rng.normal(size=3 * count + 3)
    return Sight(
        measured, np.eye(3), points, mean[3:], mean[:3], joint[3:, 3:], joint[:3, 3:]
    )  # fmt: skip


def test_jacobians_are_those_of_finite_differences() -> None:
    rng = np.random.default_rng(1)
    sight = some_sight(rng)
    step = 1e-6
    for axis in range(3):
        off = step * np.eye(3)[axis]
        numeric = (
            sight.measured.expected(sight.points + off)
            - sight.measured.expected(sight.points - off)
        ) / (2 * step)
        np.testing.assert_allclose(
            sight.measured.jacobians(sight.points)[:, :, axis], numeric, rtol=1e-6, atol=1e-4
        )


def test_left_jacobian_is_that_of_finite_differences() -> None:
    rng = np.random.default_rng(2)
    for size in (1e-6, 0.1, 2.0):
        vector = size * rng.normal(size=3)
        numeric = np.column_stack(
            [
                logarithm(exponential(vector + off) @ exponential(vector - off).T) / 2e-6
                for off in 1e-6 * np.eye(3)
            ]
        )
        np.testing.assert_allclose(left_jacobian(vector), numeric, atol=1e-6)


def test_left_jacobian_takes_a_turn_to_its_displacement() -> None:
    vector = np.array([0.3, -1.1, 0.4])
    point = np.array([2.0, 0.5, -1.0])
    np.testing.assert_allclose(
        left_jacobian(vector) @ np.cross(vector, point),
        Rotation.from_rotvec(vector).apply(point) - point,
        atol=1e-12,
    )


def test_correction_minimizes_the_prior_and_the_measurements() -> None:
    rng = np.random.default_rng(3)
    sight = some_sight(rng)
    correction = correct(sight, np.ones(7))
    assert correction is not None
    information = np.linalg.inv(sight.covariance)

    def cost(d: np.ndarray) -> float:
        # theta follows d by its regression: the measurements depend on both.
        theta = sight.theta + sight.theta_d @ information @ (d - sight.mean)
        points = sight.points + d.reshape(-1, 3) @ left_jacobian(-theta).T
        off = sight.measured.values - sight.measured.expected(points)
        prior = d - sight.mean
        return float((off**2 / sight.measured.variances).sum() + prior @ information @ prior)

    best = cost(correction.d)
    root = np.linalg.cholesky(sight.covariance)
    for _ in range(200):
        assert cost(correction.d + 0.02 * root @ rng.normal(size=len(root))) > best - 1e-2


def test_members_are_compared_with_what_the_others_say() -> None:
    """Leaving one out by the identity is leaving it out and correcting again."""
    rng = np.random.default_rng(4)
    sight = some_sight(rng)
    everyone = np.ones(7, bool)
    correction = correct(sight, np.ones(7))
    assert correction is not None
    fast = (innovations_from(sight, everyone, correction) ** 2).sum(axis=1)
    for left_out in range(7):
        others = everyone.copy()
        others[left_out] = False
        part = correct(sight.select(others), np.ones(6))
        assert part is not None
        slow = (innovations_from(sight, others, part)[left_out] ** 2).sum()
        assert fast[left_out] == pytest.approx(slow, rel=0.05, abs=0.05)


def test_nis_is_that_of_dense_algebra() -> None:
    rng = np.random.default_rng(5)
    sight = some_sight(rng, without_range=0)
    correction = correct(sight, np.ones(7))
    assert correction is not None
    H = np.zeros((21, 21))
    for j in range(7):
        H[3 * j : 3 * j + 3, 3 * j : 3 * j + 3] = correction.jacobian[j]
    S = H @ sight.covariance @ H.T + np.diag(sight.measured.variances.ravel())
    factor = np.tril(correction.factor)
    np.testing.assert_allclose(factor @ factor.T, S, rtol=1e-9, atol=1e-9)
    assert correction.nis == pytest.approx(
        correction.innovation @ np.linalg.solve(S, correction.innovation)
    )


def test_a_fiducial_behind_the_camera_gives_no_correction() -> None:
    rng = np.random.default_rng(6)
    sight = some_sight(rng)
    sight.points[3, 2] = -1.0
    assert correct(sight, np.ones(7)) is None
