"""Time limits count the robot's time where a busy machine slows a simulator down."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from infomap_ros.nodes.robot.robot_tracker import RobotTimeout

SECOND = 1_000_000_000


def ends(stamp_at: Callable[[float], int], timeout: float = 15.0) -> float:
    """When a wait that begins at 100 s is given up, looked at ten times a second [s]."""
    limit = RobotTimeout(timeout, stamp_at(0.0), 100.0)
    for tenth in range(10_000):
        if limit.is_over(stamp_at(0.1 * tenth), 100.0 + 0.1 * tenth):
            return 0.1 * tenth
    raise AssertionError("was never given up")


@pytest.mark.parametrize(
    ("pace", "seconds"), [(1.0, 15.0), (0.1, 150.0), (0.02, 750.0), (5.0, 15.0)]
)
def test_the_robots_time_counts_where_it_is_the_slower_one(pace: float, seconds: float) -> None:
    assert ends(lambda t: round(pace * t * 10) * SECOND // 10) == pytest.approx(seconds, rel=0.02)


@pytest.mark.parametrize(
    "stamp_at",
    [
        pytest.param(lambda t: -1, id="no odometry"),
        pytest.param(lambda t: 7 * SECOND, id="odometry that stands still"),
        pytest.param(lambda t: -1 if t < 2.0 else round((t + 500.0) * SECOND), id="late odometry"),
        pytest.param(lambda t: round((900.0 - t) * SECOND), id="time that goes backwards"),
        pytest.param(
            lambda t: round((3600.0 if t > 5.0 else 0.0) * SECOND + t * SECOND), id="an hour ahead"
        ),
    ],
)
def test_a_clock_of_the_robot_that_is_no_use_prolongs_nothing_much(
    stamp_at: Callable[[float], int],
) -> None:
    assert 15.0 <= ends(stamp_at) <= 17.2


def test_odometry_that_falls_silent_is_waited_for_as_long_as_without() -> None:
    silent = ends(lambda t: round(0.1 * min(t, 20.0) * 10) * SECOND // 10)
    assert silent == pytest.approx(35.0, abs=1.1)


def test_who_waits_for_ever_does() -> None:
    limit = RobotTimeout(float("inf"), 0, 0.0)
    assert not limit.is_over(10**18, 1e9)
