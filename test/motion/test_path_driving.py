from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from infomap_ros.motion.base.path_following import (
    PathDriving,
    PathFollowingConfig,
    split_path,
    wrap,
)

CONFIG = PathFollowingConfig()
PERIOD = 0.05
CORNER = np.array([(0, 0, 0), (1, 0, 0), (1, 0, 1.57), (1, 1, 1.57)], dtype=float)


def moved(pose: np.ndarray, velocity: tuple[float, float]) -> np.ndarray:
    speed, rate = velocity
    return pose + PERIOD * np.array([speed * np.cos(pose[2]), speed * np.sin(pose[2]), rate])


def test_a_path_is_driven_to_its_end_without_steps_of_speed() -> None:
    driving, pose = PathDriving(CONFIG), np.zeros(3)
    driving.follow(CORNER)
    velocities = [(0.0, 0.0)]
    while not driving.done and len(velocities) < 2000:
        velocities.append(driving.velocity(pose, PERIOD))
        pose = moved(pose, velocities[-1])
    assert driving.done
    assert not driving.problem
    assert np.linalg.norm(pose[:2] - CORNER[-1, :2]) < 0.05
    assert abs(wrap(pose[2] - 1.57)) < 0.05
    changes = np.abs(np.diff(np.array(velocities), axis=0))
    assert changes[:, 0].max() <= CONFIG.acceleration * PERIOD + 1e-9
    assert changes[:, 1].max() <= CONFIG.turn_acceleration * PERIOD + 1e-9


def test_a_stop_slows_down() -> None:
    driving, pose = PathDriving(CONFIG), np.zeros(3)
    driving.follow(CORNER)
    for _ in range(40):
        pose = moved(pose, driving.velocity(pose, PERIOD))
    driving.stop()
    speeds = [driving.velocity(pose, PERIOD)[0] for _ in range(20)]
    assert 0.0 < speeds[0] < CONFIG.max_speed
    assert speeds[-1] == 0.0
    assert driving.done


def test_a_base_that_does_not_move_is_stuck() -> None:
    driving = PathDriving(CONFIG)
    driving.follow(CORNER)
    velocities = [driving.velocity(np.array([0.3, 0.0, 0.0]), PERIOD) for _ in range(100)]
    assert driving.problem == "the base is stuck at x 0.30, y 0.00"
    assert velocities[-1] == (0.0, 0.0)


@pytest.mark.parametrize(
    ("path", "lengths"),
    [
        ([(0, 0, 0), (1, 0, 0), (2, 0, 0)], [3]),
        ([(0, 0, 0), (1, 0, 0), (1, 0, 1.5), (1, 1, 1.5)], [2, 2]),
        ([(0, 0, 0), (0, 0, 1.0), (0.5, 0.8, 1.0)], [2, 2]),
        ([(0, 0, 0), (1, 0, 0), (0.5, 0, 0)], [2, 2]),
        ([(0, 0, 0), (1, 0, 0), (1, 0, 2.0)], [2]),
        ([(0, 0, 0)], [1]),
    ],
)
def test_a_path_is_cut_where_it_turns_on_the_spot_or_back(
    path: list[tuple[float, float, float]], lengths: list[int]
) -> None:
    pieces = split_path(np.array(path, dtype=float))
    assert [len(piece) for piece in pieces] == lengths
    assert tuple(pieces[-1][-1]) == path[-1]
    for before, after in pairwise(pieces):
        np.testing.assert_array_equal(before[-1], after[0])
