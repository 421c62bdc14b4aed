from __future__ import annotations

import math

import numpy as np
import pytest

from infomap_ros.errors import InvalidInputError
from infomap_ros.geometry import MotionClock, PoseUncertainty, make_transform


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
