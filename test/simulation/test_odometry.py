from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from infomap_ros.geometry import make_transform
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.simulation.body.wheel_odometry import Odometry, OdometryConfig


def _poses() -> list[FloatArray]:
    """A curved, tilting path of 2 m."""
    return [
        make_transform(
            Rotation.from_euler("ZYX", (0.8 * s, 0.1 * np.sin(3 * s), 0.05 * s)).as_matrix(),
            (1.0 + 2.0 * s, 0.6 * s * s, 0.1 * s),
        )
        for s in np.linspace(0.0, 1.0, 40)
    ]


def test_without_noise_it_is_the_true_motion() -> None:
    poses = _poses()
    odometry = Odometry(OdometryConfig(0.0, 0.0, 0.0), np.random.default_rng(0))
    for pose in poses:
        estimate = odometry.step(pose, 0.05)
    np.testing.assert_allclose(estimate.transform, np.linalg.inv(poses[0]) @ pose, atol=1e-9)
    step = np.linalg.inv(poses[-2]) @ poses[-1]
    np.testing.assert_allclose(estimate.twist[:3], step[:3, 3] / 0.05, atol=1e-9)


def test_covariance_is_consistent_with_the_errors() -> None:
    poses = _poses()
    expected = np.linalg.inv(poses[0]) @ poses[-1]
    runs, total = 300, 0.0
    for seed in range(runs):
        odometry = Odometry(OdometryConfig(0.04, 0.02, 0.02), np.random.default_rng(seed))
        for pose in poses:
            estimate = odometry.step(pose, 0.05)
        turn = expected[:3, :3] @ estimate.transform[:3, :3].T
        error = np.concatenate(
            [expected[:3, 3] - estimate.transform[:3, 3], Rotation.from_matrix(turn).as_rotvec()]
        )
        total += error @ np.linalg.solve(estimate.covariance, error)
    low, high = chi2.ppf((0.005, 0.995), 6 * runs)
    assert low < total < high


def test_standing_still_does_not_drift() -> None:
    odometry = Odometry(OdometryConfig(), np.random.default_rng(1))
    pose = _poses()[10]
    first = odometry.step(pose, 0.05)
    for _ in range(100):
        last = odometry.step(pose, 0.05)
    np.testing.assert_allclose(last.transform, np.eye(4), atol=1e-12)
    np.testing.assert_allclose(last.covariance, first.covariance, atol=1e-12)
    assert np.linalg.eigvalsh(last.covariance).min() > 0.0
    assert last.twist == pytest.approx(np.zeros(6), abs=1e-9)
