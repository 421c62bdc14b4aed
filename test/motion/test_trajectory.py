"""Timed paths keep their limits, by finite differences."""

from __future__ import annotations

import numpy as np
import pytest

from infomap_ros.errors import ConfigError, InvalidInputError
from infomap_ros.motion.arm.arm_path import FreeSegment, TrajectoryConfig, time_path

from .bodies import rover

CHAIN = rover().arm


def random_corners(rng: np.random.Generator, corners: int) -> np.ndarray:
    scale = 10.0 ** rng.uniform(-4, 0, (corners, 1))
    return np.cumsum(scale * rng.uniform(-1, 1, (corners, len(CHAIN))), axis=0)


def anywhere(first: np.ndarray, second: np.ndarray) -> bool:
    return True


@pytest.mark.parametrize("is_free", [None, anywhere])
@pytest.mark.parametrize("period", [0.01, 0.05, 1.0])
def test_velocity_and_acceleration_keep_their_limits(
    rng: np.random.Generator, period: float, is_free: FreeSegment | None
) -> None:
    config = TrajectoryConfig(velocity_share=0.7, acceleration=0.8, period=period)
    limits = 0.7 * CHAIN.velocity
    for corners in (2, 3, 10):
        path = time_path(CHAIN, random_corners(rng, corners), config, is_free)
        steps = np.diff(path.times)
        assert path.times[0] == 0.0 and (steps > 0.0).all()
        assert steps.max() <= period * (1 + 1e-6)
        velocities = np.diff(path.positions, axis=0) / steps[:, None]
        assert (np.abs(velocities) <= limits * (1 + 1e-6)).all()
        at_rest = np.zeros((1, len(CHAIN)))
        changes = np.diff(np.concatenate([at_rest, velocities, at_rest]), axis=0)
        gaps = 0.5 * (np.append(0.0, steps) + np.append(steps, 0.0))
        assert (np.abs(changes) / gaps[:, None] <= 0.8 * (1 + 1e-6)).all()


def beside(point: np.ndarray, corners: np.ndarray) -> float:
    """How far the joint that is off most is from a path of straight pieces, at least."""
    shares = np.linspace(0.0, 1.0, 2001)[:, None]
    segments = [a + shares * (b - a) for a, b in zip(corners, corners[1:], strict=False)]  # noqa: RUF007
    return min(float(np.abs(segment - point).max(axis=1).min()) for segment in segments)


def test_corners_are_passed_within_the_deviation_and_sooner(rng: np.random.Generator) -> None:
    config = TrajectoryConfig(corner_deviation=0.02)
    for _ in range(5):
        corners = np.cumsum(rng.uniform(-0.5, 0.5, (6, len(CHAIN))), axis=0)
        stopping = time_path(CHAIN, corners, config)
        passing = time_path(CHAIN, corners, config, anywhere)
        assert passing.duration < 0.95 * stopping.duration
        np.testing.assert_allclose(passing.positions[[0, -1]], corners[[0, -1]], atol=1e-12)
        assert max(beside(q, corners) for q in passing.positions) <= 0.02 + 1e-3
        missed = [np.abs(passing.positions - corner).max(axis=1).min() for corner in corners[1:-1]]
        assert max(missed) <= 0.02 + 0.05 * 0.6  # and half a knot's way


def test_right_angle_by_hand() -> None:
    """Two joints, one after the other, that accelerate by 4: past the corner at sqrt(8 a d)."""
    config = TrajectoryConfig(velocity_share=1.0, acceleration=4.0, corner_deviation=0.005)
    corners = np.array([[0, 0, 0, 0], [1, 0, 0, 0], [1, 0, 1, 0]], float)
    path, passed = time_path(CHAIN, corners, config), time_path(CHAIN, corners, config, anywhere)
    middle = passed.positions[np.abs(1.0 - passed.positions[:, [0, 2]].sum(axis=1)).argmin()]
    np.testing.assert_allclose(middle[[0, 2]], (1.0 - 0.005, 0.005), atol=1e-9)
    speed, margin, expected = 0.4, 0.02, 0.0
    for top in CHAIN.velocity[[0, 2]]:
        climb, fall = top**2 / 8.0, (top**2 - speed**2) / 8.0
        even = 1.0 - margin - climb - fall
        expected += top / 4.0 + (top - speed) / 4.0 + even / top + margin / speed
    assert passed.duration == pytest.approx(expected, rel=1e-9)
    assert passed.duration < path.duration


def test_where_the_parabola_is_not_free_the_arm_stops() -> None:
    corners = np.array([[0, 0, 0, 0], [1, 0, 0, 0], [1, 0, 1, 0], [1, 1, 1, 0]], float)

    def blocked(first: np.ndarray, second: np.ndarray) -> bool:
        return bool(second[2] > 0.5 or first[0] < 0.9)  # the first corner is not

    path = time_path(CHAIN, corners, None, blocked)
    assert (path.positions == corners[1]).all(axis=1).any()
    assert not (path.positions == corners[2]).all(axis=1).any()


def test_straight_on_is_not_slowed_down_by_a_corner() -> None:
    corners = np.array([[0, 0, 0, 0], [0.4, 0.4, 0, 0], [1, 1, 0, 0]], float)
    through = time_path(CHAIN, corners, None, anywhere)
    direct = time_path(CHAIN, corners[[0, 2]])
    assert through.duration == pytest.approx(direct.duration, rel=1e-9)


def test_times_increase_however_little_a_path_bends(rng: np.random.Generator) -> None:
    for _ in range(100):
        corners = np.outer([0.0, 0.6, 1.0], [0.5, 1.0, -0.16, 0.3])
        corners[1] += 10.0 ** rng.uniform(-17.0, -4.0) * rng.normal(size=4)
        times = time_path(CHAIN, corners, None, anywhere).times
        assert (np.diff(times) > 0.0).all()


def test_long_piece_takes_the_time_of_the_slowest_joint() -> None:
    """By hand: the trapezoid of v = 0.6, a = 1 over 3 rad takes 3 / 0.6 + 0.6 / 1 seconds."""
    config = TrajectoryConfig(velocity_share=0.5, acceleration=1.0)
    assert CHAIN.velocity[1] == 1.2
    path = time_path(CHAIN, np.array([[0, 0, 0, 0], [0.3, -3.0, 1.0, 0]], float), config)
    assert path.duration == pytest.approx(5.6)
    middle = np.abs(path.times - 2.8).argmin()
    np.testing.assert_allclose(path.positions[middle, 1], -1.5, atol=0.02)


def test_short_piece_is_a_triangle() -> None:
    config = TrajectoryConfig(velocity_share=1.0, acceleration=1.0)
    path = time_path(CHAIN, np.array([[0, 0, 0, 0], [0.04, 0, 0, 0]], float), config)
    assert path.duration == pytest.approx(2.0 * np.sqrt(0.04))


def test_knots_lie_on_the_path_and_meet_its_corners(rng: np.random.Generator) -> None:
    corners = random_corners(rng, 6)
    path = time_path(CHAIN, corners)
    row = 0
    for first, second in zip(corners, corners[1:], strict=False):  # noqa: RUF007
        last = row + int(np.flatnonzero((path.positions[row:] == second).all(axis=1))[0])
        piece, change = path.positions[row : last + 1] - first, second - first
        shares = piece @ change / (change @ change)
        np.testing.assert_allclose(piece, shares[:, None] * change, atol=1e-12)
        assert (np.diff(shares) >= 0.0).all()
        row = last
    assert row == len(path.positions) - 1


def test_arm_that_stays_has_one_knot() -> None:
    path = time_path(CHAIN, np.ones((3, 4)))
    assert path.positions.shape == (1, 4) and path.duration == 0.0 and not path.moves


def test_malformed_input_is_named() -> None:
    with pytest.raises(InvalidInputError, match="waypoints"):
        time_path(CHAIN, np.zeros((2, 3)))
    with pytest.raises(InvalidInputError, match="finite"):
        time_path(CHAIN, np.full((2, 4), np.nan))
    with pytest.raises(ConfigError, match="velocity_share"):
        TrajectoryConfig(velocity_share=0.0)
