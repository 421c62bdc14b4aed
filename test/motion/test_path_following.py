from __future__ import annotations

import numpy as np
import pytest

from infomap_ros.errors import InvalidInputError
from infomap_ros.motion.base.path_following import PathFollower, PathFollowingConfig, wrap

CONFIG = PathFollowingConfig()
PERIOD = 0.02


def drive(path: np.ndarray, start: np.ndarray | None = None, limit: float = 120.0) -> np.ndarray:
    """Poses of an ideal vehicle that does what the follower wants, shape (n, 3)."""
    follower = PathFollower(path, CONFIG)
    pose = np.array(path[0] if start is None else start, dtype=float)
    poses = [pose.copy()]
    while not follower.done:
        speed, rate = follower.velocity(pose)
        pose += PERIOD * np.array([speed * np.cos(pose[2]), speed * np.sin(pose[2]), rate])
        poses.append(pose.copy())
        assert len(poses) < limit / PERIOD, f"not arrived: {pose}"
    return np.array(poses)


def arrives(poses: np.ndarray, goal: np.ndarray) -> bool:
    near = np.linalg.norm(poses[-1, :2] - goal[:2]) < 2.0 * CONFIG.position_tolerance
    return bool(near and abs(wrap(poses[-1, 2] - goal[2])) < 2.0 * CONFIG.angle_tolerance)


PATHS = {
    "straight": [(0, 0, 0), (1, 0, 0)],
    "curve": [(np.sin(a), 1.0 - np.cos(a), a) for a in np.linspace(0.0, 2.0, 30)],
    "backward": [(0, 0, 0.3), (-np.cos(0.3), -np.sin(0.3), 0.3)],
    "turn": [(0, 0, 0), (0, 0, 3.0)],
    "corner": [(0, 0, 0), (1, 0, 0), (1, 0, 1.57), (1, 1, 1.57)],
    "parking": [(0, 0, 0), (0.6, 0, 0), (0.6, 0, 0.8), (0.4, -0.2, 0.8), (0.4, -0.2, -1.0)],
    "long steps": [(0, 0, 0), (1, 1, 0.8), (2, 0, -0.8)],
    "stay": [(0.2, 0.1, 0.5)],
}


@pytest.mark.parametrize("name", PATHS)
def test_the_end_is_reached(name: str) -> None:
    path = np.array(PATHS[name], dtype=float)
    assert arrives(drive(path), path[-1])


def test_the_curve_is_kept_to() -> None:
    path = np.array(PATHS["curve"])
    driven = drive(path)
    assert np.abs(np.hypot(driven[:, 0], driven[:, 1] - 1.0) - 1.0).max() < 0.03


def test_backward_is_driven_backward() -> None:
    path = np.array(PATHS["backward"])
    assert np.ptp(drive(path)[:, 2]) < 0.1


def test_it_finds_back_from_beside_the_path() -> None:
    path = np.array([(x, 0.0, 0.0) for x in np.linspace(0.0, 1.5, 16)])
    driven = drive(path, np.array((0.0, 0.12, 0.2)))
    assert arrives(driven, path[-1])


def test_an_end_behind_is_not_circled_for_ever() -> None:
    path = np.array(PATHS["straight"], dtype=float)
    assert len(drive(path, np.array((1.05, 0.03, 0.1)))) < 30.0 / PERIOD


def test_speeds_keep_their_limits() -> None:
    follower = PathFollower(np.array(PATHS["corner"]), CONFIG)
    rng = np.random.default_rng(0)
    for pose in rng.uniform((-1, -1, -3), (2, 2, 3), (300, 3)):
        speed, rate = follower.velocity(pose)
        assert abs(speed) <= CONFIG.max_speed
        assert abs(rate) <= CONFIG.max_turn_rate


@pytest.mark.parametrize("path", [np.zeros((0, 3)), np.zeros((2, 2)), np.full((2, 3), np.nan)])
def test_impossible_paths_are_refused(path: np.ndarray) -> None:
    with pytest.raises(InvalidInputError, match="base path"):
        PathFollower(path, CONFIG)
