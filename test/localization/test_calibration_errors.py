"""Cameras whose calibration is off: the filter is not too sure of itself, and finds it out."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from scipy.stats import chi2

from infomap_ros.geometry import invert_transform, perturb_transform
from infomap_ros.localization.fiducials.observations import FiducialObservations
from infomap_ros.localization.filter.fiducial_filter import FiducialFilter
from infomap_ros.localization.filter.invariant_state import InvariantState, calibration_shifts
from infomap_ros.localization.filter.motion_prior import MotionPrior
from infomap_ros.localization.localizer import Localizer
from infomap_ros.localization.localizer_config import CalibrationConfig, LocalizerConfig
from test.localization import room_views
from test.localization.fiducial_scene import (
    BASELINE,
    CAMERA,
    looking,
    observe,
    pose_error,
    squared_distance,
)

PIXEL = 1.0 / (CAMERA.fx * BASELINE)  # of disparity [1/m]
SIGMAS = CalibrationConfig(0.3, 0.003, 0.003).sigmas(PIXEL)
NOTHING = np.zeros(3)
STEP = np.array([0.1, 0.1, 0.1, 0.03, 0.03, 0.03])  # sigmas of a motion without odometry [m, rad]
LOOSE = np.diag(np.square(STEP))
DRIVE = [looking(np.array([0.15 * k, 0.0, 0.0]), 0.02 * k) for k in range(40)]
"""6 m ahead, in a curve of 45 degrees."""


def hall(rng: np.random.Generator) -> np.ndarray:
    """Points on both sides of the path and at its end, shape (500, 3)."""
    x, side = rng.uniform(-1.0, 14.0, 500), rng.choice([-1.0, 1.0], 500)
    return np.column_stack([x, side * rng.uniform(1.0, 5.0, 500), rng.uniform(-1.0, 2.0, 500)])


def miscalibrated(seen: FiducialObservations, off: np.ndarray) -> FiducialObservations:
    """What a camera measures that is off by (o, s, e)."""
    center = np.array([CAMERA.cx, CAMERA.cy])
    return replace(
        seen,
        pixels=center + (seen.pixels - center) * (1.0 + off[2]),
        inverse_depths=seen.inverse_depths * (1.0 + off[1]) + off[0],
    )


def driven(seed: int, off: np.ndarray, sigmas: np.ndarray) -> FiducialFilter:
    """A filter at the end of a drive with a camera that is off."""
    rng = np.random.default_rng(seed)
    points, pose_filter = hall(rng), FiducialFilter(CAMERA)
    pose_filter.start(DRIVE[0], np.zeros((6, 6)), sigmas)
    pose_filter.add(miscalibrated(observe(points, DRIVE[0], rng), off))
    for before, after in pairwise(DRIVE):
        motion = invert_transform(before) @ after
        pose_filter.predict(MotionPrior(perturb_transform(motion, rng.normal(0, STEP)), LOOSE))
        seen = miscalibrated(observe(points, after, rng), off)
        update = pose_filter.update(seen)
        assert update.is_consistent or not sigmas.any(), update.reason
        pose_filter.add(seen.select(np.isin(seen.ids, update.unknown)))
    return pose_filter


def distance(pose_filter: FiducialFilter) -> float:
    """Squared distance of the last pose from the truth: 6 on average where sigmas hold."""
    pose, covariance = pose_filter.pose
    return squared_distance(pose_error(DRIVE[-1], pose), covariance)


def test_sigmas_hold_for_cameras_that_are_off_as_their_calibration_may_be() -> None:
    rng, count = np.random.default_rng(1), 12
    offs = rng.normal(size=(count, 3)) * SIGMAS
    aware = [distance(driven(seed, off, SIGMAS)) for seed, off in enumerate(offs)]
    assert chi2(6 * count).ppf(0.001) / 3.0 < sum(aware) < chi2(6 * count).ppf(0.999)
    sure = [distance(driven(seed, off, NOTHING)) for seed, off in enumerate(offs[:4])]
    assert np.mean(sure) > 30.0


def test_an_offset_of_the_disparities_is_found_out() -> None:
    """By things that come nearer, without anything that is known beforehand."""
    off = np.array([1.0 * PIXEL, 0.0, 0.0])
    found, never = driven(7, off, np.array([1.0 * PIXEL, 0.0, 0.0])), driven(7, off, NOTHING)
    assert found._state.calibration[0] == pytest.approx(off[0], rel=0.3)
    errors = [np.linalg.norm(pose_error(DRIVE[-1], one.pose[0])[:3]) for one in (found, never)]
    assert errors[0] < 0.4 * errors[1]


def test_scale_and_focal_length_count_and_stay_as_they_were_told() -> None:
    found = driven(3, np.array([0.0, 0.003, 0.004]), SIGMAS)
    np.testing.assert_array_equal(found._state.calibration[1:], 0.0)
    np.testing.assert_allclose(found._state.considered[7:9], np.diag(SIGMAS[1:]))


def test_points_shift_as_finite_differences_say() -> None:
    rng, step = np.random.default_rng(2), 1e-6
    points = rng.uniform([-1.0, -1.0, 1.0], [1.0, 1.0, 5.0], (9, 3))
    ids, ones = np.arange(9), np.ones(9)
    seen = FiducialObservations(ids, CAMERA.project(points), ones, 1.0 / points[:, 2], 1e-9 * ones)
    for column in range(3):
        moved = seen.corrected(CAMERA, step * np.eye(3)[column]).points(CAMERA)
        np.testing.assert_allclose(
            (moved - points) / step, calibration_shifts(points)[:, :, column], atol=1e-3
        )


def test_what_is_seen_from_where_it_was_added_shows_nothing_of_the_calibration() -> None:
    pose = looking(np.array([0.3, -0.2, 0.1]), 0.4)
    state = InvariantState(pose, 1e-4 * np.eye(6), 40, SIGMAS)
    points = np.array([[0.5, 0.2, 3.0], [-0.4, 0.1, 5.0]])
    noise = np.tile(1e-6 * np.eye(3), (2, 1, 1))
    state.add_fiducials(np.arange(2), points, noise)
    covariance, _ = state.apparent_covariance(np.arange(2), pose)
    np.testing.assert_allclose(covariance, 1e-6 * np.eye(6), atol=1e-12)
    nearer = looking(np.array([1.3, -0.2, 0.1]), 0.4)
    covariance, _ = state.apparent_covariance(np.arange(2), nearer)
    assert np.diag(covariance).min() > 1e-6 and np.diag(covariance).max() > 1e-4


def test_a_camera_is_not_lost_for_the_error_of_its_baseline() -> None:
    """After 6 m its pose is off by its scale; among the things in view it is known."""
    off = np.array([0.0, 0.003, 0.0])
    pose_filter = driven(5, off, off)
    sigmas = [
        np.sqrt(np.trace(covariance[:3, :3]))
        for covariance in (pose_filter.pose[1], pose_filter.covariance_by_calibration)
    ]
    assert sigmas[0] > 0.016 > 2.0 * sigmas[1]


def test_a_camera_without_disparities_has_no_offset_of_them() -> None:
    view = room_views.view(0, room_views.looking((0.0, 0.0, 0.0), 0.0))
    localizer = Localizer(view.camera, LocalizerConfig())
    localizer.locate(view)
    rows = np.arange(6, 9)
    prior = np.sqrt(localizer._filter._state.covariance(rows, rows))
    np.testing.assert_allclose(prior, [0.0, 0.005, 0.005])
