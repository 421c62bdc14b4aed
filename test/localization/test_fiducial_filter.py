"""The fiducial filter against batch least squares, invariants of the problem, and the truth."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.stats import chi2

from infomap_ros.errors import InvalidInputError
from infomap_ros.geometry import invert_transform, perturb_transform, transform_points
from infomap_ros.localization.fiducials.observations import FiducialObservations
from infomap_ros.localization.filter.config import FiducialFilterConfig
from infomap_ros.localization.filter.fiducial_filter import FiducialFilter
from infomap_ros.localization.filter.free_motion import free_motion
from infomap_ros.localization.filter.motion_prior import MotionPrior
from test.localization.fiducial_scene import (
    CAMERA,
    looking,
    observe,
    pose_error,
    room,
    squared_distance,
    wall,
)

ODOMETRY = np.diag([0.01**2] * 3 + [0.005**2] * 3)


def prior_of(before: np.ndarray, after: np.ndarray, rng: np.random.Generator) -> MotionPrior:
    """What odometry says of a motion."""
    error = rng.multivariate_normal(np.zeros(6), ODOMETRY)
    return MotionPrior(perturb_transform(invert_transform(before) @ after, -error), ODOMETRY)


def circle(steps: int, turns: float) -> list[np.ndarray]:
    """Poses on a small circle that look outwards."""
    angles = np.linspace(0.0, 2 * np.pi * turns, steps)
    return [looking(np.array([0.8 * np.cos(a), 0.8 * np.sin(a), 0.0]), a) for a in angles]


def follow(
    pose_filter: FiducialFilter,
    poses: list[np.ndarray],
    points: np.ndarray,
    rng: np.random.Generator,
    most: int = 25,
) -> None:
    """Take the filter along a path; it starts where the path does."""
    pose_filter.start(poses[0], np.zeros((6, 6)))
    pose_filter.add(observe(points, poses[0], rng, most=most))
    pose_filter.keep_pose(0)
    for number, (before, after) in enumerate(pairwise(poses)):
        pose_filter.predict(prior_of(before, after, rng))
        seen = observe(points, after, rng, most=most)
        update = pose_filter.update(seen)
        assert update.is_consistent, update.reason
        pose_filter.add(seen.select(np.isin(seen.ids, update.unknown)))
        pose_filter.keep_pose(number + 1)


def test_two_images_give_what_batch_least_squares_gives() -> None:
    """Pose and points of two images, each value and its covariance, by scipy."""
    rng = np.random.default_rng(1)
    points = wall(14, rng)
    poses = [np.eye(4), perturb_transform(np.eye(4), [0.1, -0.05, 0.15, 0.03, -0.05, 0.02])]
    seen = [observe(points, pose, rng) for pose in poses]
    prior = prior_of(*poses, rng)
    pose_filter = FiducialFilter(CAMERA)
    pose_filter.add(seen[0])
    pose_filter.predict(prior)
    assert pose_filter.update(seen[1]).is_consistent
    count = len(seen[0])

    def residuals(x: np.ndarray) -> np.ndarray:
        pose = perturb_transform(poses[1], x[:6])
        where = x[6:].reshape(-1, 3)
        off = [pose_error(pose, prior.T_before_after) / np.sqrt(np.diag(ODOMETRY))]
        for view, at in zip(seen, (np.eye(4), pose), strict=True):
            inside = transform_points(invert_transform(at), where)
            off.append(((CAMERA.project(inside) - view.pixels) / 0.3).ravel())
            off.append((1 / inside[:, 2] - view.inverse_depths) / view.inverse_depth_sigmas)
        return np.concatenate(off)

    best = least_squares(residuals, np.concatenate([np.zeros(6), points.ravel()]), x_scale="jac")
    covariance = np.linalg.inv(best.jac.T @ best.jac)
    estimated, pose_covariance = pose_filter.pose
    sigmas = np.sqrt(np.diag(covariance))
    off = pose_error(perturb_transform(poses[1], best.x[:6]), estimated)
    assert np.abs(off / sigmas[:6]).max() < 0.2
    np.testing.assert_allclose(np.sqrt(np.diag(pose_covariance)), sigmas[:6], rtol=0.05)
    fiducials = pose_filter.fiducials()
    off = (fiducials.positions - best.x[6:].reshape(-1, 3)) / sigmas[6:].reshape(-1, 3)
    assert np.abs(off).max() < 0.3
    np.testing.assert_allclose(
        np.sqrt(np.einsum("nii->ni", fiducials.covariances)),
        sigmas[6:].reshape(count, 3),
        rtol=0.1,
    )


def test_looking_again_tells_nothing_of_where_everything_is() -> None:
    """The absolute pose of all is not observable: no number of images makes it more certain."""
    rng = np.random.default_rng(2)
    points = room(200, rng)
    start = np.diag([1e-2] * 3 + [4e-2] * 3)
    pose_filter = FiducialFilter(CAMERA)
    poses = circle(20, 0.3)
    pose_filter.start(poses[0], start)
    pose_filter.add(observe(points, poses[0], rng))
    pose_filter.keep_pose(1)
    for before, after in pairwise(poses):
        pose_filter.predict(prior_of(before, after, rng))
        seen = observe(points, after, rng)
        pose_filter.add(seen.select(np.isin(seen.ids, pose_filter.update(seen).unknown)))
    first = pose_filter.kept_poses().covariances[0]
    assert np.all(np.diag(first) > 0.999 * np.diag(start))
    _, covariance = pose_filter.pose
    assert np.all(np.linalg.eigvalsh(covariance[3:, 3:]) > 0.999 * 4e-2)


def test_poses_and_fiducials_err_as_much_as_they_say() -> None:
    """NEES over independent runs within its 99.9 % band."""
    runs = 12
    pose_sum = kept_sum = 0.0
    for seed in range(runs):
        rng = np.random.default_rng([3, seed])
        points = room(150, rng)
        poses = circle(12, 0.35)
        pose_filter = FiducialFilter(CAMERA)
        follow(pose_filter, poses, points, rng)
        estimated, covariance = pose_filter.pose
        pose_sum += squared_distance(pose_error(poses[-1], estimated), covariance)
        kept = pose_filter.kept_poses()
        kept_sum += squared_distance(pose_error(poses[6], kept.transforms[6]), kept.covariances[6])
    low, high = chi2.ppf([0.0005, 0.9995], 6 * runs) / runs
    assert low < pose_sum / runs < high
    assert low < kept_sum / runs < high


def test_images_alone_suffice() -> None:
    rng = np.random.default_rng(4)
    points = room(200, rng)
    poses = circle(15, 0.3)
    pose_filter = FiducialFilter(CAMERA)
    pose_filter.start(poses[0], np.zeros((6, 6)))
    pose_filter.add(observe(points, poses[0], rng))
    for pose in poses[1:]:
        pose_filter.predict(free_motion(0.5))
        seen = observe(points, pose, rng)
        update = pose_filter.update(seen)
        assert update.is_consistent, update.reason
        pose_filter.add(seen.select(np.isin(seen.ids, update.unknown)))
    estimated, covariance = pose_filter.pose
    error = pose_error(poses[-1], estimated)
    assert np.linalg.norm(error[:3]) < 0.05
    assert squared_distance(error, covariance) < chi2.ppf(0.999, 6)


def test_a_big_step_without_prior_is_found() -> None:
    """30 degrees and 0.5 m between two images of a free camera."""
    rng = np.random.default_rng(5)
    points = wall(60, rng)
    pose = perturb_transform(np.eye(4), [0.4, -0.1, 0.3, 0.1, -0.3, 0.4])
    pose_filter = FiducialFilter(CAMERA)
    pose_filter.add(observe(points, np.eye(4), rng))
    pose_filter.predict(free_motion(1.0))
    assert pose_filter.update(observe(points, pose, rng)).is_consistent
    estimated, covariance = pose_filter.pose
    assert squared_distance(pose_error(pose, estimated), covariance) < chi2.ppf(0.999, 6)


def test_coming_back_takes_out_the_drift() -> None:
    rng = np.random.default_rng(6)
    points = room(300, rng)
    poses = circle(41, 1.0)
    pose_filter = FiducialFilter(CAMERA)
    follow(pose_filter, poses[:36], points, rng, most=12)
    away = np.trace(pose_filter.pose[1][:3, :3])
    middle = pose_filter.kept_poses().covariances[30]
    for before, after in pairwise(poses[35:]):
        pose_filter.predict(prior_of(before, after, rng))
        update = pose_filter.update(observe(points, after, rng, most=12))
        assert update.is_consistent, update.reason
    estimated, covariance = pose_filter.pose
    assert np.trace(covariance[:3, :3]) < 0.3 * away
    corrected = pose_filter.kept_poses().covariances[30]
    assert np.trace(corrected[:3, :3]) < 0.7 * np.trace(middle[:3, :3])
    assert squared_distance(pose_error(poses[-1], estimated), covariance) < chi2.ppf(0.999, 6)


def test_the_target_corrects_the_kept_poses() -> None:
    """A start that is known poorly: the target turns and shifts the whole way by as much."""
    rng = np.random.default_rng(7)
    points = room(200, rng)
    poses = circle(10, 0.25)
    start = np.diag([0.2**2] * 3 + [0.15**2] * 3)
    offset = np.array([0.3, -0.2, 0.1, 0.1, -0.1, 0.2])
    pose_filter = FiducialFilter(CAMERA)
    pose_filter.start(perturb_transform(poses[0], -offset), start)
    pose_filter.add(observe(points, poses[0], rng))
    for number, (before, after) in enumerate(pairwise(poses)):
        pose_filter.predict(prior_of(before, after, rng))
        seen = observe(points, after, rng)
        update = pose_filter.update(seen)
        assert update.is_consistent, update.reason
        pose_filter.add(seen.select(np.isin(seen.ids, update.unknown)))
        pose_filter.keep_pose(number)
    before_it = pose_filter.kept_poses()
    assert np.linalg.norm(pose_error(poses[1], before_it.transforms[0])[:3]) > 0.2
    sighting = np.diag([0.002**2] * 3 + [0.002**2] * 3)
    measured = perturb_transform(poses[-1], rng.multivariate_normal(np.zeros(6), sighting))
    assert pose_filter.observe_pose(measured, sighting)
    kept = pose_filter.kept_poses()
    for number in range(9):
        error = pose_error(poses[number + 1], kept.transforms[number])
        assert np.linalg.norm(error[:3]) < 0.03
        assert squared_distance(error, kept.covariances[number]) < 40.0  # 6 degrees of freedom


def test_an_absolute_pose_is_fused_as_two_gaussians() -> None:
    """At the origin the conventions agree, so the result is the information-weighted mean."""
    first, second = np.diag([1.0, 2, 3, 1, 2, 3]) * 1e-4, np.diag([3.0, 2, 1, 3, 2, 1]) * 1e-4
    shift = np.array([0.01, -0.02, 0.01, 0.0, 0.0, 0.0])
    pose_filter = FiducialFilter(CAMERA)
    pose_filter.start(np.eye(4), first)
    assert pose_filter.observe_pose(perturb_transform(np.eye(4), shift), second)
    pose, covariance = pose_filter.pose
    information = np.linalg.inv(first) + np.linalg.inv(second)
    np.testing.assert_allclose(covariance, np.linalg.inv(information), rtol=0.01, atol=1e-6)
    expected = np.linalg.solve(information, np.linalg.solve(second, shift))
    np.testing.assert_allclose(pose[:3, 3], expected[:3], atol=1e-5)


def test_a_contradicting_absolute_pose_changes_nothing() -> None:
    pose_filter = FiducialFilter(CAMERA)
    pose_filter.start(np.eye(4), 1e-6 * np.eye(6))
    far = perturb_transform(np.eye(4), [1.0, 0, 0, 0, 0, 0])
    assert not pose_filter.observe_pose(far, 1e-6 * np.eye(6))
    np.testing.assert_array_equal(pose_filter.pose[0], np.eye(4))


def test_fiducials_without_range_still_tell_of_the_pose() -> None:
    rng = np.random.default_rng(8)
    points = wall(40, rng)
    pose = perturb_transform(np.eye(4), [0.1, 0.0, 0.1, 0.02, 0.03, 0.0])
    seen = observe(points, pose, rng)
    nothing = np.full(len(seen), np.nan)
    flat = FiducialObservations(seen.ids, seen.pixels, seen.pixel_sigmas, nothing, nothing)
    pose_filter = FiducialFilter(CAMERA)
    pose_filter.add(observe(points, np.eye(4), rng))
    pose_filter.predict(free_motion(0.5))
    update = pose_filter.update(flat)
    assert update.is_consistent, update.reason
    assert update.degrees_of_freedom == 2 * len(update.used)
    estimated, covariance = pose_filter.pose
    assert squared_distance(pose_error(pose, estimated), covariance) < chi2.ppf(0.999, 6)


def test_mismatched_fiducials_are_rejected_by_name() -> None:
    rng = np.random.default_rng(9)
    points = wall(40, rng)
    pose = perturb_transform(np.eye(4), [0.05, 0.0, 0.05, 0.0, 0.02, 0.0])
    pose_filter = FiducialFilter(CAMERA)
    pose_filter.add(observe(points, np.eye(4), rng))
    seen = observe(points, pose, rng)
    seen.pixels[:6] += rng.uniform(8, 30, (6, 2))
    pose_filter.predict(prior_of(np.eye(4), pose, rng))
    update = pose_filter.update(seen)
    assert update.is_consistent
    assert set(seen.ids[:6].tolist()) <= set(update.rejected.tolist())
    assert len(update.used) > 0.9 * (len(seen) - 6)
    estimated, covariance = pose_filter.pose
    assert squared_distance(pose_error(pose, estimated), covariance) < chi2.ppf(0.999, 6)


def test_two_groups_that_move_apart_give_no_pose_without_odometry() -> None:
    rng = np.random.default_rng(10)
    points = wall(60, rng)
    pose_filter = FiducialFilter(CAMERA)
    pose_filter.add(observe(points, np.eye(4), rng))
    points[::2] += [0.15, 0.05, 0.0]
    pose_filter.predict(free_motion(0.5))
    before = pose_filter.pose
    update = pose_filter.update(observe(points, np.eye(4), rng))
    assert not update.is_consistent
    assert update.reason == "two groups of fiducials show different motions"
    for old, new in zip(before, pose_filter.pose, strict=True):
        np.testing.assert_array_equal(old, new)


def test_odometry_tells_which_of_two_groups_moves() -> None:
    rng = np.random.default_rng(11)
    points = wall(60, rng)
    pose_filter = FiducialFilter(CAMERA)
    pose_filter.add(observe(points, np.eye(4), rng))
    points[::2] += [0.3, 0.05, 0.0]
    pose_filter.predict(prior_of(np.eye(4), np.eye(4), rng))
    update = pose_filter.update(observe(points, np.eye(4), rng))
    assert update.is_consistent, update.reason
    assert np.all(update.used % 2 == 1)
    estimated, covariance = pose_filter.pose
    assert squared_distance(pose_error(np.eye(4), estimated), covariance) < chi2.ppf(0.999, 6)


def test_a_small_second_group_makes_the_motion_ambiguous() -> None:
    """Seven against four that move together: without odometry nobody knows."""
    rng = np.random.default_rng(18)
    points = wall(11, rng)
    pose_filter = FiducialFilter(CAMERA)
    pose_filter.add(observe(points, np.eye(4), rng))
    points[:4] += [0.2, 0.1, 0.0]
    pose_filter.predict(free_motion(0.5))
    assert not pose_filter.update(observe(points, np.eye(4), rng)).is_consistent


def test_new_fiducials_on_a_moving_body_do_not_decide() -> None:
    """Fifteen that are known for longer against thirty that were added a moment ago."""
    rng = np.random.default_rng(19)
    points = wall(45, rng)
    old = points[:15]
    pose_filter = FiducialFilter(CAMERA)
    pose_filter.add(observe(old, np.eye(4), rng))
    pose_filter.predict(free_motion(0.1))
    assert pose_filter.update(observe(old, np.eye(4), rng)).is_consistent
    pose_filter.add(observe(points, np.eye(4), rng))
    points[15:] += [0.3, 0.0, 0.1]
    pose_filter.predict(free_motion(0.5))
    update = pose_filter.update(observe(points, np.eye(4), rng))
    assert update.is_consistent, update.reason
    assert np.all(update.used < 15) and len(update.rejected) >= 30
    estimated, covariance = pose_filter.pose
    assert squared_distance(pose_error(np.eye(4), estimated), covariance) < chi2.ppf(0.999, 6)


@pytest.mark.parametrize(("moved", "is_believed"), [(0.0, True), (0.3, False)])
def test_after_a_contradiction_those_that_may_not_vote_are_witnesses(
    moved: float, is_believed: bool
) -> None:
    """Forty that vote and agree are believed again if thirty new ones agree with them too."""
    rng = np.random.default_rng(23)
    points = wall(70, rng)
    old = points[:40].copy()
    pose_filter = FiducialFilter(CAMERA)
    pose_filter.add(observe(old, np.eye(4), rng))
    pose_filter.predict(free_motion(0.1))
    assert pose_filter.update(observe(old, np.eye(4), rng)).is_consistent
    old[::2] += [0.15, 0.05, 0.0]
    pose_filter.predict(free_motion(0.5))
    assert not pose_filter.update(observe(old, np.eye(4), rng)).is_consistent
    old[::2] -= [0.15, 0.05, 0.0]
    pose_filter.predict(free_motion(0.1))
    pose_filter.add(observe(points, pose_filter.pose[0], rng))
    points[40:] += [moved, 0.0, 0.1 * moved]
    update = pose_filter.update(observe(points, np.eye(4), rng))
    assert update.is_consistent == is_believed, update.reason
    if not is_believed:
        assert "too few" in update.reason


def test_nearly_all_fiducials_overrule_slipping_wheels() -> None:
    rng = np.random.default_rng(12)
    points = wall(50, rng)
    pose_filter = FiducialFilter(CAMERA)
    pose_filter.add(observe(points, np.eye(4), rng))
    rest = MotionPrior(np.eye(4), ODOMETRY)
    pose_filter.predict(rest)
    assert pose_filter.update(observe(points, np.eye(4), rng)).is_consistent
    slipped = perturb_transform(np.eye(4), [0.2, 0.0, 0.1, 0.0, 0.05, 0.0])
    pose_filter.predict(rest)
    update = pose_filter.update(observe(points, slipped, rng))
    assert update.is_consistent and update.prior_overruled
    estimated, covariance = pose_filter.pose
    assert squared_distance(pose_error(slipped, estimated), covariance) < chi2.ppf(0.999, 6)


@pytest.mark.parametrize(("shift", "clustered"), [(0.5, False), (0.2, True)])
def test_wheels_are_not_overruled_by_a_leap_or_by_few_fiducials_in_one_place(
    shift: float, clustered: bool
) -> None:
    rng = np.random.default_rng(12)
    points = wall(50, rng)
    if clustered:
        points = points[0] + rng.uniform(-0.03, 0.03, (10, 3))
    pose_filter = FiducialFilter(CAMERA)
    pose_filter.add(observe(points, np.eye(4), rng))
    rest = MotionPrior(np.eye(4), ODOMETRY)
    pose_filter.predict(rest)
    assert pose_filter.update(observe(points, np.eye(4), rng)).is_consistent
    pose_filter.predict(rest)
    leap = perturb_transform(np.eye(4), [shift, 0.0, 0.0, 0.0, 0.0, 0.0])
    expected = pose_filter.pose[0]
    update = pose_filter.update(observe(points, leap, rng))
    assert not update.is_consistent
    assert "contradicts" in update.reason
    np.testing.assert_array_equal(pose_filter.pose[0], expected)


def test_unseen_motion_adds_up_until_an_image_is_understood() -> None:
    rng = np.random.default_rng(13)
    points = wall(50, rng)
    poses = [perturb_transform(np.eye(4), [0.04 * k, 0, 0, 0, 0.01 * k, 0]) for k in range(5)]
    pose_filter = FiducialFilter(CAMERA)
    pose_filter.add(observe(points, poses[0], rng))
    for before, after in pairwise(poses):
        pose_filter.predict(prior_of(before, after, rng))
    estimated, covariance = pose_filter.pose
    assert covariance[0, 0] >= 4 * 0.01**2
    assert squared_distance(pose_error(poses[-1], estimated), covariance) < chi2.ppf(0.999, 6)
    nothing = observe(points, poses[-1], rng).select(np.zeros(0, int))
    assert "0 known fiducials" in pose_filter.update(nothing).reason
    assert pose_filter.update(observe(points, poses[-1], rng)).is_consistent
    assert pose_filter.pose[1][0, 0] < 0.01**2


def test_a_saved_filter_goes_on_as_the_one_that_was_saved() -> None:
    rng = np.random.default_rng(14)
    points = room(200, rng)
    poses = circle(8, 0.2)
    pose_filter = FiducialFilter(CAMERA)
    follow(pose_filter, poses, points, rng)
    pose_filter.predict(prior_of(poses[-1], poses[-1], rng))
    again = FiducialFilter(CAMERA)
    again.resume(pose_filter.state())
    seen = observe(points, poses[-1], rng)
    for one in (pose_filter, again):
        assert one.update(seen).is_consistent
    np.testing.assert_array_equal(again.pose[0], pose_filter.pose[0])
    np.testing.assert_array_equal(again.pose[1], pose_filter.pose[1])


def test_what_is_held_stays_bounded() -> None:
    rng = np.random.default_rng(15)
    config = FiducialFilterConfig(max_fiducials=30, max_kept_poses=4)
    points = room(300, rng)
    pose_filter = FiducialFilter(CAMERA, config)
    follow(pose_filter, circle(20, 0.6), points, rng, most=20)
    assert len(pose_filter.fiducials()) <= 30
    kept = pose_filter.kept_poses()
    assert len(kept) == 4
    assert kept.stamps[0] == 0 and kept.stamps[-1] == 19


def test_forgotten_things_are_gone_and_the_rest_stays() -> None:
    rng = np.random.default_rng(16)
    points = room(200, rng)
    pose_filter = FiducialFilter(CAMERA)
    follow(pose_filter, circle(6, 0.15), points, rng)
    before = pose_filter.fiducials()
    gone = before.ids[::3]
    pose_filter.remove(gone)
    pose_filter.forget_poses([1, 3, 77])
    after = pose_filter.fiducials()
    left = ~np.isin(before.ids, gone)
    np.testing.assert_array_equal(after.ids, before.ids[left])
    np.testing.assert_array_equal(after.covariances, before.covariances[left])
    np.testing.assert_array_equal(pose_filter.kept_poses().stamps, [0, 2, 4, 5])


def test_only_certain_ranges_are_added() -> None:
    rng = np.random.default_rng(17)
    points = np.array([[0.1, 0.0, 2.0], [0.2, 0.1, 60.0]])
    seen = observe(points, np.eye(4), None)
    assert len(seen) == 2
    pose_filter = FiducialFilter(CAMERA)
    assert pose_filter.add(seen).tolist() == [0]
    assert pose_filter.add(observe(points, np.eye(4), rng)).tolist() == []


def test_stamps_of_kept_poses_must_grow() -> None:
    pose_filter = FiducialFilter(CAMERA)
    pose_filter.keep_pose(5)
    with pytest.raises(InvalidInputError, match="stamp"):
        pose_filter.keep_pose(5)


def test_a_start_must_be_a_pose_with_a_covariance() -> None:
    with pytest.raises(InvalidInputError, match="T_map_camera"):
        FiducialFilter(CAMERA).start(np.zeros((4, 4)), np.eye(6))
    with pytest.raises(InvalidInputError, match="covariance"):
        FiducialFilter(CAMERA).start(np.eye(4), np.eye(5))


@pytest.mark.parametrize("sigma", [1e3, 1e6, 1e9])
def test_a_camera_that_may_be_anywhere_at_all_is_no_error(sigma: float) -> None:
    """Beside such a covariance the noise of an image vanishes in rounding."""
    rng = np.random.default_rng(5)
    points = wall(30, rng)
    pose_filter = FiducialFilter(CAMERA)
    pose_filter.start(np.eye(4), np.zeros((6, 6)))
    pose_filter.add(observe(points, np.eye(4), rng))
    pose_filter.predict(MotionPrior(np.eye(4), np.diag([sigma**2] * 3 + [1.0] * 3)))
    moved = looking(np.array([0.1, 0.0, 0.0]), 0.0) @ invert_transform(looking(np.zeros(3), 0.0))
    update = pose_filter.update(observe(points, moved, rng))
    if update.is_consistent:
        assert pose_error(pose_filter.pose[0], moved)[:3] == pytest.approx(np.zeros(3), abs=0.1)
