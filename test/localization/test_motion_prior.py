"""Motion priors against sampled motions."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from infomap_ros.errors import InvalidInputError
from infomap_ros.geometry import invert_transform, make_transform, perturb_transform
from infomap_ros.localization.dead_reckoning import DeadReckoningConfig
from infomap_ros.localization.filter.free_motion import free_motion
from infomap_ros.localization.filter.motion_prior import KinematicMotion, MotionPrior, RobotPosture
from test.localization.fiducial_scene import pose_error


def some_pose(rng: np.random.Generator, size: float) -> np.ndarray:
    rotation = Rotation.from_rotvec(rng.normal(0, 0.5, 3)).as_matrix()
    return make_transform(rotation, rng.normal(0, size, 3))


def sampled(prior: MotionPrior, rng: np.random.Generator) -> np.ndarray:
    return perturb_transform(
        prior.T_before_after, rng.multivariate_normal(np.zeros(6), prior.covariance)
    )


def test_motions_add_up_as_samples_do() -> None:
    rng = np.random.default_rng(1)
    roots = rng.normal(0, 0.004, (2, 6, 6))
    first, second = (MotionPrior(some_pose(rng, 0.5), root @ root.T) for root in roots)
    both = first.then(second)
    errors = np.array(
        [
            pose_error(sampled(first, rng) @ sampled(second, rng), both.T_before_after)
            for _ in range(4000)
        ]
    )
    scale = np.sqrt(np.diag(both.covariance))
    np.testing.assert_allclose(
        np.cov(errors.T) / np.outer(scale, scale),
        both.covariance / np.outer(scale, scale),
        atol=0.08,
    )


def test_free_motion_grows_with_time_and_stays_bounded() -> None:
    np.testing.assert_allclose(
        np.sqrt(np.diag(free_motion(0.1).covariance)), [0.07] * 3 + [0.1] * 3
    )
    np.testing.assert_array_equal(free_motion(3.0).covariance, free_motion(99.0).covariance)


@pytest.mark.parametrize("duration", [-0.1, np.nan])
def test_impossible_durations_are_refused(duration: float) -> None:
    with pytest.raises(InvalidInputError, match="duration"):
        free_motion(duration)


def test_kinematic_motion_is_that_of_the_camera() -> None:
    rng = np.random.default_rng(2)
    before = RobotPosture(some_pose(rng, 2.0), some_pose(rng, 0.5))
    after = RobotPosture(some_pose(rng, 2.0), some_pose(rng, 0.5))
    prior = KinematicMotion().between(before, after)
    np.testing.assert_allclose(
        before.T_odom_camera @ prior.T_before_after, after.T_odom_camera, atol=1e-12
    )


def test_kinematic_covariance_is_that_of_sampled_errors() -> None:
    rng = np.random.default_rng(3)
    config = DeadReckoningConfig(
        position_per_meter=0.03,
        position_per_radian=0.04,
        rotation_per_meter=0.01,
        rotation_per_radian=0.02,
        kinematics_position_sigma=0.004,
        kinematics_rotation_sigma=0.005,
    )
    base_motion = make_transform(Rotation.from_euler("z", 0.6).as_matrix(), [0.5, 0.2, 0.0])
    before = RobotPosture(some_pose(rng, 2.0), some_pose(rng, 0.8))
    after = RobotPosture(before.T_odom_base @ base_motion, some_pose(rng, 0.8))
    prior = KinematicMotion(config).between(before, after)
    distance = np.linalg.norm(base_motion[:3, 3])
    sigmas = np.sqrt(
        [0.03**2 * distance + 0.04**2 * 0.6] * 3 + [0.01**2 * distance + 0.02**2 * 0.6] * 3
    )
    ends = np.repeat([0.004, 0.005], 3)
    errors = []
    for _ in range(4000):
        # Kinematics err about the camera's axes at either end, odometry in the old base's frame.
        true_base = perturb_transform(base_motion, sigmas * rng.normal(size=6))
        start = before.T_base_camera @ perturb_transform(np.eye(4), ends * rng.normal(size=6))
        end = after.T_base_camera @ perturb_transform(np.eye(4), ends * rng.normal(size=6))
        errors.append(pose_error(invert_transform(start) @ true_base @ end, prior.T_before_after))
    scale = np.sqrt(np.diag(prior.covariance))
    np.testing.assert_allclose(
        np.cov(np.array(errors).T) / np.outer(scale, scale),
        prior.covariance / np.outer(scale, scale),
        atol=0.1,
    )


def test_a_prior_must_be_rigid_and_have_a_covariance() -> None:
    with pytest.raises(InvalidInputError, match="T_before_after"):
        MotionPrior(2.0 * np.eye(4), np.eye(6))
    with pytest.raises(InvalidInputError, match="covariance"):
        MotionPrior(np.eye(4), -np.eye(6))


def test_a_robot_that_stands_is_where_it_was_as_surely_as_then() -> None:
    rng = np.random.default_rng(4)
    motion, here = KinematicMotion(), RobotPosture(some_pose(rng, 1.0), some_pose(rng, 0.3))
    still = RobotPosture(perturb_transform(here.T_odom_base, 5e-4 * np.ones(6)), here.T_base_camera)
    assert not motion.since(here, still).covariance.any()
    gone = RobotPosture(perturb_transform(here.T_odom_base, 5e-2 * np.ones(6)), here.T_base_camera)
    expected = motion.between(here, gone)
    np.testing.assert_array_equal(motion.since(here, gone).covariance, expected.covariance)
    np.testing.assert_array_equal(motion.since(here, gone).T_before_after, expected.T_before_after)
