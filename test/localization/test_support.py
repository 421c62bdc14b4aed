"""Fiducials that nothing would contradict if they were mistaken for others do not count."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from infomap_ros.geometry import make_transform
from infomap_ros.localization.fiducials.observations import FiducialObservations
from infomap_ros.localization.filter.config import FiducialFilterConfig
from infomap_ros.localization.filter.fiducial_filter import FiducialFilter
from infomap_ros.localization.filter.hypothesis_choice import UNSUPPORTED, controlled
from infomap_ros.localization.filter.motion_prior import MotionPrior
from infomap_ros.localization.filter.sight import Measured, Sight

from .fiducial_scene import CAMERA, observe, pose_error, squared_distance, wall

LEAST = FiducialFilterConfig().min_redundancy


def sight_of(points: np.ndarray, covariance: np.ndarray) -> tuple[Sight, np.ndarray]:
    """What is known of points in the camera frame, shape (M, 3), and the derivatives there."""
    seen = Measured.of(CAMERA, observe(points, np.eye(4), None))
    assert len(seen) == len(points)
    nothing = np.zeros(covariance.shape[0])
    sight = Sight(
        seen, np.eye(3), points, nothing, np.zeros(3), covariance, np.zeros((3, len(nothing)))
    )
    return sight, seen.jacobians(points)


def places(counts: list[int], spread: float) -> np.ndarray:
    """Covariance of fiducials of several places, each of which is off as a whole, (3M, 3M)."""
    place = np.repeat(np.arange(len(counts)), counts)
    together = (place[:, None] == place[None]).astype(float)
    together[np.ix_(place == 0, place == 0)] = 0.0  # the first place is known
    return spread**2 * np.kron(together, np.eye(3)) + 1e-8 * np.eye(3 * len(place))


@pytest.mark.parametrize(("strangers", "count"), [(1, 0), (2, 0), (6, 6)])
def test_one_or_two_of_a_roughly_known_place_do_not_count(strangers: int, count: int) -> None:
    points = wall(10 + strangers, np.random.default_rng(1))
    points *= 3.0 / points[:, 2:]  # then all tell as much
    covariance = places([10, strangers], spread=0.05)
    left = controlled(*sight_of(points, covariance), least=LEAST)
    assert left[:10].all()
    assert np.count_nonzero(left[10:]) == count


def test_one_fiducial_of_a_well_known_place_counts() -> None:
    points = wall(11, np.random.default_rng(1))
    covariance = places([10, 1], spread=0.001)
    assert controlled(*sight_of(points, covariance), least=LEAST).all()


def naive_excess(sight: Sight, jacobian: np.ndarray) -> np.ndarray:
    """By how much too little of an error would show, from whole matrices, shape (M,)."""
    count = len(jacobian)
    H, A = np.zeros((3 * count, 3 * count)), np.zeros((3 * count, 6))
    for k, (block, y) in enumerate(zip(jacobian, sight.points, strict=True)):
        H[3 * k : 3 * k + 3, 3 * k : 3 * k + 3] = block
        turned = np.cross(np.eye(3), y).T  # of a turn about each axis
        A[3 * k : 3 * k + 3] = np.hstack([block, block @ -turned])
    variances = np.maximum(sight.measured.variances, [1.0, 1.0, 0.0]).ravel()
    R, W = np.diag(variances), np.diag(1.0 / variances)
    full = np.linalg.inv(H @ sight.covariance @ H.T + R)
    by_pose = W - W @ A @ np.linalg.solve(A.T @ W @ A, A.T @ W)
    own = [slice(3 * k, 3 * k + 2) for k in range(count)]
    by_map = [np.linalg.eigvalsh((by_pose - full)[each, each])[-1] for each in own]
    return np.array(by_map) - (1.0 - LEAST)


def test_the_worst_is_left_out_until_all_others_would_show() -> None:
    rng = np.random.default_rng(2)
    points = wall(12, rng)
    mixed = rng.normal(size=(36, 14)) * rng.uniform(0.0, 0.003, 36)[:, None]
    sight, jacobian = sight_of(points, mixed @ mixed.T)
    remaining = np.ones(12, bool)
    while True:
        excess = naive_excess(sight.select(remaining), jacobian[remaining])
        if excess.max() <= 0.0:
            break
        remaining[np.flatnonzero(remaining)[excess.argmax()]] = False
    assert 3 < np.count_nonzero(remaining) < 12
    np.testing.assert_array_equal(controlled(sight, jacobian, LEAST), remaining)


def two_rooms(rng: np.random.Generator) -> tuple[FiducialFilter, np.ndarray, np.ndarray]:
    """A filter that has seen one place, gone blindly to another one and settled there.

    Returns:
        The filter, all points, of which the first 30 are of the first place, and the true pose.
    """
    points = wall(60, rng)
    pose_filter = FiducialFilter(CAMERA)
    first = np.eye(4)
    pose_filter.add(observe(points[:30], first, rng))
    pose_filter.update(observe(points[:30], first, rng))
    sigmas = np.repeat([0.02, 0.01], 3)
    error = rng.normal(size=6) * sigmas
    true = make_transform(Rotation.from_rotvec(error[3:]).as_matrix(), error[:3])
    pose_filter.predict(MotionPrior(np.eye(4), np.diag(sigmas**2)))
    names = np.arange(60)
    pose_filter.add(observe(points[30:], true, rng, names[30:]))
    return pose_filter, points, true


def seen_again(
    points: np.ndarray, true: np.ndarray, old: int, shift: float, rng: np.random.Generator
) -> FiducialObservations:
    """The second place and some fiducials of the first, these seen beside their places [px]."""
    chosen = np.r_[np.arange(old), np.arange(30, 60)]
    seen = observe(points[chosen], true, rng, chosen)
    pixels = seen.pixels + np.where(seen.ids[:, None] < 30, [shift, 0.0], 0.0)
    return replace(seen, pixels=pixels)


REST = MotionPrior(np.eye(4), 1e-8 * np.eye(6))


def test_two_mistaken_fiducials_do_not_pull_a_place_along() -> None:
    rng = np.random.default_rng(3)
    distances = []
    for _ in range(20):
        pose_filter, points, true = two_rooms(rng)
        pose_filter.predict(REST)
        seen = seen_again(points, true, 2, 6.0, rng)
        update = pose_filter.update(seen)
        assert update.is_consistent
        assert not np.isin([0, 1], update.used).any()
        estimate, covariance = pose_filter.pose
        distances.append(squared_distance(pose_error(true, estimate), covariance))
    assert 3.0 < np.mean(distances) < 9.5  # 99.9 % of the mean of 20 with 6 degrees of freedom


def test_many_old_fiducials_close_the_loop() -> None:
    rng = np.random.default_rng(4)
    distances = []
    for _ in range(20):
        pose_filter, points, true = two_rooms(rng)
        before = np.sqrt(np.diag(pose_filter.pose[1]))
        pose_filter.predict(REST)
        update = pose_filter.update(seen_again(points, true, 20, 0.0, rng))
        assert np.isin(np.arange(20), update.used).sum() > 12
        estimate, covariance = pose_filter.pose
        assert (np.sqrt(np.diag(covariance)) < 0.5 * before).all()
        distances.append(squared_distance(pose_error(true, estimate), covariance))
    assert 3.0 < np.mean(distances) < 9.5


def test_where_too_few_are_left_the_pose_stays() -> None:
    rng = np.random.default_rng(5)
    pose_filter, points, true = two_rooms(rng)
    expected = pose_filter.pose
    seen = seen_again(points, true, 2, 0.0, rng)
    update = pose_filter.update(seen.select(seen.ids < 34))
    assert (update.is_consistent, update.reason) == (False, UNSUPPORTED)
    for now, before in zip(pose_filter.pose, expected, strict=True):
        np.testing.assert_array_equal(now, before)
