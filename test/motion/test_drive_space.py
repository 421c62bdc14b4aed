"""Paths over ground that is not known everywhere."""

from __future__ import annotations

import numpy as np

from infomap_ros.geometry import make_transform
from infomap_ros.motion.base.drive_space import standing_on


def tilted(x: float, y: float, yaw: float, height: float, pitch: float) -> np.ndarray:
    turn = np.array(
        [[np.cos(yaw), -np.sin(yaw), 0.0], [np.sin(yaw), np.cos(yaw), 0.0], [0.0, 0.0, 1.0]]
    )
    tilt = np.array(
        [[np.cos(pitch), 0.0, np.sin(pitch)], [0.0, 1.0, 0.0], [-np.sin(pitch), 0.0, np.cos(pitch)]]
    )
    return make_transform(turn @ tilt, (x, y, height))


def test_unknown_stances_come_from_their_neighbors() -> None:
    poses = np.array([[0.0, 0.0, 0.0], [0.1, 0.0, 0.5], [0.2, 0.1, 0.5], [0.3, 0.1, 1.0]])
    stances = np.stack([tilted(x, y, yaw, 0.2, 0.1) for x, y, yaw in poses])
    expected = stances.copy()
    stances[[0, 2]] = np.nan
    np.testing.assert_allclose(standing_on(poses, stances), expected, atol=1e-12)


def test_known_stances_stay_and_no_stance_is_level() -> None:
    poses = np.array([[0.0, 0.0, 0.3], [1.0, 2.0, 0.3]])
    stances = np.stack([tilted(x, y, yaw, 0.2, 0.1) for x, y, yaw in poses])
    np.testing.assert_array_equal(standing_on(poses, stances), stances)
    level = np.stack([tilted(x, y, yaw, 0.0, 0.0) for x, y, yaw in poses])
    np.testing.assert_allclose(standing_on(poses, np.full((2, 4, 4), np.nan)), level, atol=1e-12)
    assert standing_on(np.zeros((0, 3)), np.zeros((0, 4, 4))).shape == (0, 4, 4)
