"""The study of pose consistency: its room against the truth, its bands against scipy."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from infomap_ros.geometry import invert_transform, perturb_transform, transform_points
from infomap_ros.studies.pose_consistency import (
    CAMERA,
    SCENARIOS,
    PoseConsistencyConfig,
    Room,
    ScenarioResult,
    circle,
    mean_band,
    odometry,
    pose_error,
    pose_summary,
    pose_table,
    run_pose_consistency,
)


@pytest.fixture(scope="module")
def results() -> list[ScenarioResult]:
    return run_pose_consistency(PoseConsistencyConfig(runs=2, steps=30, measured=30, seed=5))


def test_bands_are_those_of_the_chi_square_distribution() -> None:
    low, high = mean_band(100, 6)
    assert stats.chi2.cdf(100 * low, 600) == pytest.approx(0.025)
    assert stats.chi2.cdf(100 * high, 600) == pytest.approx(0.975)


def test_pose_error_undoes_the_perturbation() -> None:
    pose = circle(5, 0.3)[3]
    error = np.array([0.1, -0.2, 0.3, 0.05, 0.02, -0.04])
    np.testing.assert_allclose(pose_error(perturb_transform(pose, error), pose), error)


def test_measurements_are_of_what_is_in_view(rng: np.random.Generator) -> None:
    room = Room.random(200, 0.0, rng)
    pose = circle(8, 1.0)[3]
    seen = room.observe(pose, 500, False, rng)
    inside = transform_points(invert_transform(pose), room.points[seen.ids])
    off = (seen.pixels - CAMERA.project(inside)) / seen.pixel_sigmas[:, None]
    rho = (seen.inverse_depths - 1.0 / inside[:, 2]) / seen.inverse_depth_sigmas
    assert len(seen) > 20
    assert np.abs(off).max() < 5.0 and np.abs(rho).max() < 5.0


def test_the_body_moves_and_nothing_else(rng: np.random.Generator) -> None:
    room = Room.random(100, 0.05, rng)
    before = room.points.copy()
    room.move_body()
    np.testing.assert_array_equal(room.points[~room.on_body], before[~room.on_body])
    moved = room.points[room.on_body].mean(axis=0) - before[room.on_body].mean(axis=0)
    assert np.linalg.norm(moved) == pytest.approx(0.05)


def test_half_of_the_measured_fiducials_are_on_the_body(rng: np.random.Generator) -> None:
    room = Room.random(250, 0.05, rng)
    seen = room.observe(circle(4, 0.2)[0], 20, True, rng)
    assert room.on_body[seen.ids].sum() == 10 == (~room.on_body[seen.ids]).sum()


def test_odometry_errs_by_its_covariance(rng: np.random.Generator) -> None:
    first, second = circle(2, 0.1)[:2]
    priors = [odometry(first, second, rng) for _ in range(500)]
    motion = invert_transform(first) @ second
    errors = np.array([pose_error(motion, prior.T_before_after) for prior in priors])
    sigmas = np.sqrt(np.diag(priors[0].covariance))
    np.testing.assert_allclose(errors.std(axis=0) / sigmas, 1.0, atol=0.12)


def test_poses_are_updated_and_their_errors_as_large_as_stated(
    results: list[ScenarioResult],
) -> None:
    for result in results[:2]:
        assert result.updated == 1.0
        assert result.last.mean() < stats.chi2.ppf(0.9999, 6 * 2) / 2
        assert result.last_error < 0.1


def test_no_pose_is_wrong_where_half_of_all_moves(results: list[ScenarioResult]) -> None:
    for result in results[2:]:
        assert result.wrong == 0 and result.is_consistent
    assert results[2].updated > results[3].updated  # odometry tells which half moves


def test_table_and_summary_hold_every_scenario(results: list[ScenarioResult]) -> None:
    assert len(pose_table(results).splitlines()) == 2 + len(SCENARIOS)
    figures = pose_summary(results, 1.0)
    assert figures["nees_last_1"] == pytest.approx(results[0].last.mean())
    assert all(isinstance(value, int | float) for value in figures.values())
