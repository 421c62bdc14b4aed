"""A camera of which nothing is known is as fast as it was seen to be."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from infomap_ros.geometry import make_transform
from infomap_ros.localization.filter.free_motion import FreeMotion

WALK = make_transform(Rotation.from_rotvec([0.0, 0.02, 0.0]).as_matrix(), [0.0, 0.0, 0.1])


def sigmas(motion: FreeMotion, duration: float) -> np.ndarray:
    return np.sqrt(np.diag(motion.expected(duration).covariance))


def test_at_first_it_may_go_anywhere_at_the_speed_of_a_hand() -> None:
    motion = FreeMotion()
    np.testing.assert_array_equal(motion.expected(0.1).T_before_after, np.eye(4))
    np.testing.assert_allclose(sigmas(motion, 0.1), [0.07] * 3 + [0.1] * 3)


def test_it_goes_on_as_it_went_for_as_long_as_is_asked() -> None:
    motion = FreeMotion()
    motion.note(WALK, 0.1)
    twice = motion.expected(0.2).T_before_after
    np.testing.assert_allclose(twice[:3, 3], [0.0, 0.0, 0.2])
    turn = Rotation.from_matrix(twice[:3, :3]).as_rotvec()
    np.testing.assert_allclose(turn, [0.0, 0.04, 0.0], atol=1e-12)


def test_who_is_fast_may_change_speed_by_more() -> None:
    slow, fast = FreeMotion(), FreeMotion()
    slow.note(WALK, 0.1)
    fast.note(make_transform(np.eye(3), [0.0, 0.0, 2.0]), 0.1)
    # A car that brakes at 10 m/s^2 loses 0.1 m on the way of a tenth of a second.
    assert sigmas(fast, 0.1)[2] > 0.1 > sigmas(slow, 0.1)[2]


@pytest.mark.parametrize("speed", [0.1, 1.0, 10.0, 35.0])
def test_the_widest_holds_any_vehicle(speed: float) -> None:
    *_, widest = FreeMotion().wider(0.1)
    assert np.sqrt(widest.covariance[0, 0]) >= 0.1 * speed


def test_what_was_forgotten_is_not_expected() -> None:
    motion = FreeMotion()
    motion.note(WALK, 0.1)
    motion.clear()
    np.testing.assert_array_equal(motion.expected(1.0).T_before_after, np.eye(4))


def test_a_gyroscope_tells_the_turn_and_what_it_tells_at_rest_is_learnt() -> None:
    rng, motion = np.random.default_rng(3), FreeMotion()
    bias, duration = np.array([0.02, -0.03, 0.01]), 0.1
    squares = []
    for step in range(200):
        turned = Rotation.from_rotvec([0.05 * np.sin(0.1 * step), 0.03, 0.0])
        told = turned * Rotation.from_rotvec(bias * duration + rng.normal(0.0, 3e-4, 3))
        motion.turn = told.as_matrix()
        expected = motion.expected(duration)
        error = (turned.inv() * Rotation.from_matrix(expected.T_before_after[:3, :3])).as_rotvec()
        squares.append(error @ np.linalg.solve(expected.covariance[3:, 3:], error) / 3.0)
        seen = turned * Rotation.from_rotvec(rng.normal(0.0, 1e-3, 3))
        motion.note(make_transform(seen.as_matrix(), [0.0, 0.0, 0.01]), duration)
    assert np.mean(squares) < 1.5
    assert np.linalg.norm(error) < 1.5e-3 < np.linalg.norm(bias * duration)
    assert sigmas(motion, duration)[3:].max() < 3e-3
    np.testing.assert_allclose(
        sigmas(motion, duration)[:3], sigmas(FreeMotion(), 0.1)[:3], rtol=0.1
    )


def test_images_of_a_moment_in_which_the_gyroscope_was_wrong_teach_nothing() -> None:
    motion = FreeMotion()
    for _ in range(100):
        motion.turn = np.eye(3)
        motion.note(np.eye(4), 0.1)
    motion.turn = Rotation.from_rotvec([0.0, 1.0, 0.0]).as_matrix()
    motion.note(np.eye(4), 0.1)
    motion.turn = np.eye(3)
    turn = Rotation.from_matrix(motion.expected(0.1).T_before_after[:3, :3])
    assert turn.magnitude() < 1e-3
