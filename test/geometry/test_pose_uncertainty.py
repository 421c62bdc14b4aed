from __future__ import annotations

import math

import numpy as np
import pytest

from infomap_ros.errors import InvalidInputError
from infomap_ros.geometry import MotionClock, PoseUncertainty, make_transform, perturb_transform
from infomap_ros.geometry.pose_uncertainty import point_covariances, positive_part


def test_the_parts_add_up_to_the_covariance():
    rng = np.random.default_rng(1)
    parts = [a @ a.T for a in rng.normal(size=(3, 6, 6))]
    told = PoseUncertainty(*parts)
    np.testing.assert_allclose(told.covariance, sum(parts))


@pytest.mark.parametrize("part", ["drift", "white", "offset"])
def test_a_part_that_is_no_covariance_is_refused_by_name(part):
    parts = {"drift": np.eye(6), part: -np.eye(6)}
    with pytest.raises(InvalidInputError, match=part):
        PoseUncertainty(**parts)


def test_drift_correlates_by_the_difference_of_the_clocks():
    first, second = (PoseUncertainty(np.eye(6), clock=clock) for clock in (3.0, 5.0))
    assert first.correlation(second) == pytest.approx(math.exp(-2.0))
    assert second.correlation(first) == first.correlation(second)
    assert first.correlation(first) == 1.0


def test_the_motion_clock_stands_while_the_camera_rests_and_runs_as_it_moves():
    clock = MotionClock()
    assert {clock.at(np.eye(4)) for _ in range(100)} == {0.0}
    ahead = make_transform(np.eye(3), [2.0, 0.0, 0.0])
    assert clock.at(ahead) == pytest.approx(2.0)
    quarter = make_transform([[0, -1, 0], [1, 0, 0], [0, 0, 1]], [2.0, 0.0, 0.0])
    assert clock.at(quarter) == pytest.approx(2.0 + math.pi / 2 / 0.5)
    assert clock.at(quarter) == clock.at(quarter)


def test_an_offset_moves_points_of_the_map_as_it_moves_the_camera(rng):
    root = rng.normal(size=(6, 6)) * 1e-3
    told = PoseUncertainty(np.zeros((6, 6)), offset=root @ root.T)
    camera = make_transform(np.eye(3), [1.0, -2.0, 0.5])
    points = rng.normal(size=(5, 3)) * 3.0
    errors = rng.multivariate_normal(np.zeros(6), told.offset, 20_000)
    moved = np.empty((len(errors), 5, 3))
    for n, error in enumerate(errors):
        wrong = perturb_transform(camera, error)
        moved[n] = (points - camera[:3, 3]) @ wrong[:3, :3].T + wrong[:3, 3]
    expected = point_covariances(told.offset_at_origin(camera[:3, 3]), points)
    for n in range(5):
        np.testing.assert_allclose(
            np.cov(moved[:, n].T), expected[n], atol=0.03 * expected[n].max()
        )


def test_another_covariance_is_shared_out_as_before_and_keeps_offset_and_clock(rng):
    total, offset = 3.0 * np.eye(6), 0.5 * np.eye(6)
    told = PoseUncertainty(0.6 * np.eye(6), 0.2 * np.eye(6), offset, 7.0)
    other = told.with_covariance(total)
    np.testing.assert_allclose(other.covariance, total)
    np.testing.assert_allclose(other.drift, 0.75 * (total - offset))
    np.testing.assert_array_equal(other.offset, offset)
    assert other.clock == 7.0
    exact = PoseUncertainty(np.zeros((6, 6))).with_covariance(total)
    np.testing.assert_allclose(exact.drift, total)


def test_the_positive_part_is_the_matrix_without_its_negative_eigenvalues(rng):
    axes = np.linalg.qr(rng.normal(size=(4, 4)))[0]
    matrix = (axes * [3.0, 1.0, -2.0, 0.0]) @ axes.T
    expected = (axes * [3.0, 1.0, 0.0, 0.0]) @ axes.T
    np.testing.assert_allclose(positive_part(matrix), expected, atol=1e-12)


def test_a_covariance_alone_is_drift_by_the_clock_of_the_motion():
    clock = MotionClock()
    first = clock.uncertainty(np.eye(6), np.eye(4))
    second = clock.uncertainty(np.eye(6), make_transform(np.eye(3), [0.5, 0.0, 0.0]))
    np.testing.assert_array_equal(first.drift, np.eye(6))
    assert first.correlation(second) == pytest.approx(math.exp(-0.5))
    with pytest.raises(InvalidInputError, match="pose_covariance"):
        clock.uncertainty(-np.eye(6), np.eye(4))
