"""Dead reckoning: poses by composition, covariances against simulated drift."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from infomap_ros.geometry import (
    OdometryRecord,
    PoseRecord,
    make_transform,
    perturb_transform,
)
from infomap_ros.localization.dead_reckoning import DeadReckoning, DeadReckoningConfig

T_BASE_CAMERA = make_transform(
    Rotation.from_euler("xyz", (-1.9, 0.1, -1.4)).as_matrix(), (0.3, 0.1, 0.8)
)


def pose(x: float, y: float, yaw: float) -> np.ndarray:
    return make_transform(Rotation.from_euler("z", yaw).as_matrix(), (x, y, 0.0))


def perturbation(true: np.ndarray, measured: np.ndarray) -> np.ndarray:
    """(dt, dtheta) with ``true = perturb(measured)``."""
    turn = Rotation.from_matrix(true[:3, :3] @ measured[:3, :3].T).as_rotvec()
    return np.concatenate([true[:3, 3] - measured[:3, 3], turn])


def test_pose_is_the_product_of_its_parts() -> None:
    start = pose(5.0, -2.0, 0.7)
    reckoning = DeadReckoning(T_map_odom=start)
    base = reckoning.add(OdometryRecord(7, "odom", pose(1.0, 2.0, 0.3), np.eye(6), "base_link"))
    camera = reckoning.camera_pose(base, T_BASE_CAMERA, "camera")
    np.testing.assert_allclose(camera.transform, start @ pose(1.0, 2.0, 0.3) @ T_BASE_CAMERA)
    assert (camera.stamp, camera.frame_id, camera.child_frame_id) == (7, "map", "camera")


def test_covariance_at_the_end_of_the_lever_is_that_of_sampled_poses() -> None:
    rng = np.random.default_rng(3)
    factor = 0.004 * rng.normal(size=(6, 6))
    covariance = factor @ factor.T
    config = DeadReckoningConfig(kinematics_position_sigma=1e-6, kinematics_rotation_sigma=1e-6)
    reckoning = DeadReckoning(config, T_map_odom=pose(1.0, 1.0, 1.1))
    odometry = pose(3.0, 1.0, -0.4)
    base = reckoning.add(OdometryRecord(0, "odom", odometry, covariance))
    camera = reckoning.camera_pose(base, T_BASE_CAMERA, "camera")
    errors = []
    for draw in rng.multivariate_normal(np.zeros(6), covariance, 20000):
        true = pose(1.0, 1.0, 1.1) @ perturb_transform(odometry, draw) @ T_BASE_CAMERA
        errors.append(perturbation(true, camera.transform))
    sampled = np.cov(np.array(errors).T)
    scale = np.sqrt(np.outer(np.diag(sampled), np.diag(sampled)))
    assert camera.covariance is not None
    np.testing.assert_allclose(camera.covariance / scale, sampled / scale, atol=0.03)


@pytest.mark.parametrize("given", [None, np.zeros((6, 6))])
def test_unknown_covariance_grows_like_the_drift_of_random_steps(given: np.ndarray | None) -> None:
    config = DeadReckoningConfig(
        position_per_meter=0.02,
        position_per_radian=0.03,
        rotation_per_meter=0.02,
        rotation_per_radian=0.03,
    )
    steps = [pose(0.1, 0.0, 0.05)] * 60
    reckoning, measured = DeadReckoning(config), np.eye(4)
    for step in [np.eye(4), *steps]:
        measured = measured @ step
        base = reckoning.add(OdometryRecord(0, "odom", measured, given))
    rng = np.random.default_rng(5)
    sigma_position = np.sqrt(0.02**2 * 0.1 + 0.03**2 * 0.05)
    sigma_rotation = np.sqrt(0.02**2 * 0.1 + 0.03**2 * 0.05)
    sigmas = [sigma_position] * 3 + [sigma_rotation] * 3
    errors = []
    for _ in range(1500):
        true = np.eye(4)
        for step in steps:
            true = perturb_transform(true @ step, rng.normal(0.0, sigmas))
        errors.append(perturbation(true, measured))
    assert base.covariance is not None
    ratio = np.diag(base.covariance) / np.var(errors, axis=0)
    # each step's noise acts at the step's end: half a step more or less is within the tolerance
    np.testing.assert_allclose(ratio, 1.0, atol=0.15)


def test_kinematics_add_their_own_uncertainty() -> None:
    reckoning = DeadReckoning()
    base = PoseRecord(0, "map", np.eye(4), np.zeros((6, 6)))
    camera = reckoning.camera_pose(base, T_BASE_CAMERA, "camera")
    config = reckoning.config
    position, rotation = config.kinematics_position_sigma, config.kinematics_rotation_sigma
    expected = np.diag([position**2] * 3 + [rotation**2] * 3)
    np.testing.assert_allclose(camera.covariance, expected)
    np.testing.assert_allclose(camera.transform, T_BASE_CAMERA)
