"""Camera motion from points before and after, against exact motions and a batch estimate."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from infomap_ros.errors import ConfigError, InvalidInputError
from infomap_ros.geometry import make_transform, transform_points
from infomap_ros.studies.camera_motion import (
    MotionConfig,
    RecursivePose,
    estimate_motion,
    printed_motion,
)


def some_motion(rng: np.random.Generator) -> np.ndarray:
    return make_transform(
        Rotation.from_rotvec(rng.normal(0, 0.3, 3)).as_matrix(), rng.normal(0, 0.3, 3)
    )


def stereo_covariances(points: np.ndarray) -> np.ndarray:
    """5 mm at 1 m along the ray, growing with the square of the depth; 1 mm across."""
    rays = points / np.linalg.norm(points, axis=1, keepdims=True)
    along = (0.005 * points[:, 2] ** 2) ** 2
    return along[:, None, None] * rays[:, :, None] * rays[:, None, :] + 1e-6 * np.eye(3)


def noisy(points: np.ndarray, covariances: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    roots = np.linalg.cholesky(covariances)
    return points + np.einsum("nij,nj->ni", roots, rng.normal(size=points.shape))


def seen_twice(rng: np.random.Generator, count: int = 30) -> tuple[np.ndarray, ...]:
    """True motion, noisy points before and after, their covariances."""
    motion = some_motion(rng)
    before = rng.uniform([-2, -1, 2], [2, 1, 5], (count, 3))
    after = transform_points(motion, before)
    noise = stereo_covariances(before), stereo_covariances(after)
    return motion, noisy(before, noise[0], rng), noise[0], noisy(after, noise[1], rng), noise[1]


def error_of(motion: np.ndarray, estimated: np.ndarray) -> np.ndarray:
    turned = Rotation.from_matrix(motion[:3, :3] @ estimated[:3, :3].T).as_rotvec()
    return np.concatenate([motion[:3, 3] - estimated[:3, 3], turned])


def batch_motion(before, noise_before, after, noise_after, first) -> np.ndarray:
    """Weighted least squares by scipy: an independent minimizer of the same sum."""

    def residuals(x: np.ndarray) -> np.ndarray:
        rotation = Rotation.from_rotvec(x[3:]).as_matrix() @ first[:3, :3]
        off = after - before @ rotation.T - x[:3]
        roots = np.linalg.cholesky(noise_after + rotation @ noise_before @ rotation.T)
        return np.linalg.solve(roots, off[:, :, None]).ravel()

    best = least_squares(residuals, np.concatenate([first[:3, 3], np.zeros(3)]), x_scale=1e-3)
    rotation = Rotation.from_rotvec(best.x[3:]).as_matrix() @ first[:3, :3]
    return make_transform(rotation, best.x[:3])


def test_printed_method_recovers_an_exact_motion() -> None:
    rng = np.random.default_rng(1)
    motion, points = some_motion(rng), rng.uniform(-1, 1, (6, 3))
    np.testing.assert_allclose(
        printed_motion(points, transform_points(motion, points)), motion, atol=1e-9
    )


def test_printed_method_is_the_projected_least_squares_solution() -> None:
    rng = np.random.default_rng(2)
    _, before, _, after, _ = seen_twice(rng)
    affine = np.linalg.lstsq(np.column_stack([before, np.ones(len(before))]), after, rcond=None)[0]
    expected = Rotation.from_matrix(affine[:3].T).as_matrix()  # the nearest rotation, by scipy
    np.testing.assert_allclose(printed_motion(before, after)[:3, :3], expected, atol=1e-8)


def test_printed_method_refuses_points_in_one_plane() -> None:
    points = np.random.default_rng(3).uniform(-1, 1, (8, 3)) * [1, 1, 0]
    with pytest.raises(InvalidInputError, match="one plane"):
        printed_motion(points, points)


def test_printed_method_needs_four_points() -> None:
    with pytest.raises(InvalidInputError, match="3 points, at least 4"):
        printed_motion(np.eye(3), np.eye(3))


def test_estimate_agrees_with_a_batch_estimate() -> None:
    rng = np.random.default_rng(4)
    motion, before, _, after, _ = seen_twice(rng)
    # Isotropic noise, a different one for each point: then the weights do not turn with the motion.
    noise = rng.uniform(0.01, 0.1, (30, 1, 1)) ** 2 * np.eye(3)
    config = MotionConfig(gate=0.999999, certain=0.999999)  # no weight is lowered
    estimate = estimate_motion(before, noise, after, noise, config)
    assert estimate.converged and estimate.inliers.all()
    off = error_of(batch_motion(before, noise, after, noise, motion), estimate.T_after_before)
    assert np.all(np.abs(off) < 1e-3 * np.sqrt(np.diag(estimate.covariance)))


def test_covariance_is_honest() -> None:
    rng = np.random.default_rng(5)
    runs = 250
    total = 0.0
    for _ in range(runs):
        motion, *pairs = seen_twice(rng, 20)
        estimate = estimate_motion(*pairs)
        off = error_of(motion, estimate.T_after_before)
        total += off @ np.linalg.solve(estimate.covariance, off)
    low, high = chi2.ppf([0.005, 0.995], 6 * runs) / runs
    assert low < total / runs < high


def test_outliers_are_left_out() -> None:
    rng = np.random.default_rng(6)
    motion, before, noise_before, after, noise_after = seen_twice(rng, 40)
    after[:18] += rng.uniform(0.3, 1.0, (18, 3))
    estimate = estimate_motion(before, noise_before, after, noise_after)
    assert estimate.converged
    assert not estimate.inliers[:18].any()
    assert estimate.inliers[18:].sum() >= 21
    off = error_of(motion, estimate.T_after_before)
    assert off @ np.linalg.solve(estimate.covariance, off) < chi2.ppf(0.999, 6)


def test_points_on_a_line_give_no_motion() -> None:
    points = np.linspace(1, 3, 8)[:, None] * np.array([0.1, 0.2, 1.0])
    noise = np.tile(1e-6 * np.eye(3), (8, 1, 1))
    estimate = estimate_motion(points, noise, points, noise)
    assert not estimate.converged
    assert estimate.T_after_before is None and estimate.covariance is None
    assert "line" in estimate.reason


def test_points_that_move_apart_give_no_motion() -> None:
    rng = np.random.default_rng(7)
    noise = np.tile(1e-8 * np.eye(3), (12, 1, 1))
    estimate = estimate_motion(
        rng.uniform(-1, 1, (12, 3)), noise, rng.uniform(-1, 1, (12, 3)), noise
    )
    assert not estimate.converged and estimate.reason


def test_too_few_pairs_give_no_motion() -> None:
    noise = np.tile(np.eye(3), (3, 1, 1))
    assert "3 pairs" in estimate_motion(np.eye(3), noise, np.eye(3), noise).reason


@pytest.mark.parametrize("bad", [np.full((5, 3), np.nan), np.zeros((5, 2)), np.zeros((4, 3))])
def test_bad_points_are_refused(bad: np.ndarray) -> None:
    noise = np.tile(np.eye(3), (5, 1, 1))
    with pytest.raises(InvalidInputError):
        estimate_motion(np.zeros((5, 3)), noise, bad, noise)


def test_bad_covariances_are_refused() -> None:
    points = np.zeros((5, 3))
    with pytest.raises(InvalidInputError, match="covariances_after"):
        estimate_motion(points, np.tile(np.eye(3), (5, 1, 1)), points, np.eye(3))


def test_config_is_checked() -> None:
    with pytest.raises(ConfigError, match="min_pairs"):
        MotionConfig(min_pairs=2)


def test_recursive_pose_is_the_batch_mean_and_covariance() -> None:
    rng = np.random.default_rng(8)
    center = some_motion(rng)
    recursive = RecursivePose()
    offsets = rng.multivariate_normal(np.zeros(6), np.diag([4, 1, 9, 1, 2, 3]) * 1e-6, 400)
    poses = [
        make_transform(
            Rotation.from_rotvec(o[3:]).as_matrix() @ center[:3, :3], center[:3, 3] + o[:3]
        )
        for o in offsets
    ]
    for pose in poses:
        recursive.add(pose)
    np.testing.assert_allclose(
        recursive.mean[:3, 3], np.mean([p[:3, 3] for p in poses], axis=0), atol=1e-12
    )
    errors = np.array([error_of(pose, recursive.mean) for pose in poses])
    np.testing.assert_allclose(
        recursive.covariance, np.cov(errors.T, bias=True), atol=1e-3 * np.cov(errors.T).max()
    )


def test_recursive_pose_of_nothing_is_refused_and_of_one_is_unsure() -> None:
    recursive = RecursivePose()
    with pytest.raises(InvalidInputError):
        _ = recursive.mean
    recursive.add(np.eye(4))
    assert np.isnan(recursive.covariance).all()
