"""The parts of a pose's covariance, against identities and against errors that are known."""

from __future__ import annotations

import math

import numpy as np
import pytest

from infomap_ros.geometry import PoseUncertainty, invert_transform, perturb_transform
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.localization.filter.fiducial_filter import FiducialFilter
from infomap_ros.studies.pose_consistency import CAMERA, Room, circle, odometry, pose_error

START = np.diag([0.01**2] * 3 + [0.003**2] * 3)
NOTHING = np.zeros((6, 6))
RANGE = 2.0  # [m] of the points whose displacement is compared
CIRCLE = circle(100, 1.0)  # 6 cm and 3.6 degrees an image


class Walk:
    """A filter with odometry in a room, and what it gives for each image."""

    def __init__(self, seed: int, start: FloatArray) -> None:
        self.rng = np.random.default_rng(seed)
        self.room, self.filter = Room.random(120, 0.0, self.rng), FiducialFilter(CAMERA)
        error = self.rng.multivariate_normal(np.zeros(6), start)
        self.filter.start(perturb_transform(CIRCLE[0], -error), start)
        self.place = 0
        self.parts: list[PoseUncertainty] = []
        self.errors: list[FloatArray] = []
        self.filter.add(self._seen())
        self._note(is_keyframe=True)

    def go(self, images: int, *, dark: bool = False) -> None:
        for _ in range(images):
            before, after = CIRCLE[self.place], CIRCLE[self.place + 1]
            self.filter.predict(odometry(before, after, self.rng))
            self.place += 1
            if not dark:
                seen = self._seen()
                update = self.filter.update(seen)
                self.filter.add(seen.select(np.isin(seen.ids, update.unknown)))
            self._note(is_keyframe=self.place % 3 == 0 and not dark)

    def rest(self, images: int) -> None:
        for _ in range(images):
            self._note(is_keyframe=False)

    def correlation(self, first: int, second: int) -> float:
        """Of the points' displacements by the two poses' errors, as the parts say."""
        one, other = self.parts[first], self.parts[second]
        drift, offset = (
            math.sqrt(mean_square(getattr(one, part)) * mean_square(getattr(other, part)))
            for part in ("drift", "offset")
        )
        sizes = mean_square(one.covariance) * mean_square(other.covariance)
        return (one.correlation(other) * drift + offset) / math.sqrt(sizes)

    def _seen(self):
        return self.room.observe(CIRCLE[self.place], 20, False, self.rng)

    def _note(self, *, is_keyframe: bool) -> None:
        pose, covariance = self.filter.pose
        parts = self.filter.divide_covariance(is_keyframe=is_keyframe)
        np.testing.assert_allclose(parts.covariance, covariance, atol=1e-12)
        self.parts.append(parts)
        self.errors.append(pose_error(CIRCLE[self.place], pose))


def mean_square(covariance: FloatArray) -> float:
    return float(np.trace(covariance[:3, :3]) + RANGE**2 * np.trace(covariance[3:, 3:]))


def test_the_error_of_the_first_pose_is_the_offset_of_all():
    """By an identity: an error of the frame shifts a pose by dt + theta x (way since)."""
    walk = Walk(1, START)
    walk.go(12)

    offset = walk.filter.pose[0][:3, 3] - CIRCLE[0][:3, 3]
    over = np.eye(6)
    over[:3, 3:] = [
        [0, offset[2], -offset[1]],
        [-offset[2], 0, offset[0]],
        [offset[1], -offset[0], 0],
    ]
    np.testing.assert_allclose(walk.parts[-1].offset, over @ START @ over.T, rtol=0.05, atol=5e-6)
    np.testing.assert_allclose(walk.parts[0].offset, START, rtol=1e-9, atol=1e-12)


def test_an_absolute_pose_makes_the_offset_smaller():
    walk = Walk(1, START)
    walk.go(3)

    assert walk.filter.observe_pose(CIRCLE[3], 0.01 * START)
    walk.rest(1)

    assert mean_square(walk.parts[-1].offset) < 0.1 * mean_square(START)


def test_a_camera_that_rests_has_the_same_error():
    walk = Walk(2, START)
    walk.go(8)
    walk.rest(5)

    clocks = {parts.clock for parts in walk.parts[-6:]}
    assert len(clocks) == 1
    for parts in walk.parts[-5:]:
        np.testing.assert_allclose(parts.white, NOTHING, atol=1e-15)


def test_poses_by_odometry_alone_are_a_random_walk():
    """By an identity: of a random walk, the correlation is the ratio of the sigmas."""
    walk = Walk(3, NOTHING)
    walk.go(6)
    walk.go(4, dark=True)

    before, *coasting = walk.parts[-5:]
    for after in coasting:
        expected = math.sqrt(mean_square(before.covariance) / mean_square(after.covariance))
        assert before.correlation(after) == pytest.approx(expected, rel=1e-6)
        np.testing.assert_allclose(after.white, NOTHING, atol=1e-15)
        before = after


@pytest.mark.parametrize("lag", [1, 4, 8])
def test_errors_correlate_as_the_parts_say(walks: list[Walk], lag: int):
    """True errors of the walks, each in its own standard deviations, against the parts."""
    products, squares, told = 0.0, [0.0, 0.0], []
    for walk in walks:
        for first in range(4, 13 - lag):
            one, other = (displacements(walk, k, first) for k in (first, first + lag))
            products += float(one @ other)
            squares[0] += float(one @ one)
            squares[1] += float(other @ other)
            told.append(walk.correlation(first, first + lag))
    assert np.mean(told) == pytest.approx(products / math.sqrt(math.prod(squares)), abs=0.1)


@pytest.fixture(scope="module")
def walks() -> list[Walk]:
    made = [Walk(100 + seed, NOTHING) for seed in range(60)]
    for walk in made:
        walk.go(12)
    return made


def displacements(walk: Walk, number: int, place: int) -> FloatArray:
    """An error about a place of the circle, in standard deviations, shape (6,).

    Its square is the mean square displacement of points at `RANGE`.
    """
    error = walk.errors[number]
    offset = CIRCLE[place][:3, 3] - CIRCLE[number][:3, 3]
    shift = np.concatenate([error[:3] + np.cross(error[3:], offset), RANGE * error[3:]])
    return np.asarray(shift / math.sqrt(mean_square(walk.parts[number].covariance)))


def test_a_filter_that_was_resumed_divides_as_the_one_that_went_on():
    walk, again = Walk(5, START), FiducialFilter(CAMERA)
    walk.go(7)
    again.resume(walk.filter.state())
    prior = odometry(CIRCLE[7], CIRCLE[8], np.random.default_rng(1))
    seen = walk.room.observe(CIRCLE[8], 20, False, np.random.default_rng(2))
    given = []
    for each in (walk.filter, again):
        each.predict(prior)
        each.update(seen)
        given.append(each.divide_covariance(is_keyframe=False))
    assert given[0].clock == given[1].clock
    np.testing.assert_array_equal(given[0].drift, given[1].drift)


def test_where_the_map_is_put_elsewhere_its_error_is_one_for_all():
    walk = Walk(6, START)
    walk.go(6)
    rotation = [[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]
    T_new_old = np.eye(4)
    T_new_old[:3, :3], T_new_old[:3, 3] = rotation, [3.0, 1.0, 0.0]
    clock, covariance = walk.parts[-1].clock, np.diag([0.05**2] * 3 + [0.0] * 3)

    walk.filter.move(T_new_old, covariance)
    after = walk.filter.divide_covariance(is_keyframe=False)

    turn = np.kron(np.eye(2), rotation)
    expected = turn @ walk.parts[-1].offset @ turn.T + covariance
    np.testing.assert_allclose(after.offset, expected, rtol=1e-6, atol=1e-9)
    assert after.clock == pytest.approx(clock, abs=1e-9)


def test_what_begins_anew_shares_nothing_with_what_was():
    walk = Walk(7, START)
    before = walk.parts[-1]

    walk.filter.start(invert_transform(CIRCLE[0]), START)

    assert before.correlation(walk.filter.divide_covariance(is_keyframe=True)) < 0.01
