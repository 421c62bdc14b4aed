"""Where an image is linearized must not matter to what odometry says."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from infomap_ros.geometry import make_transform
from infomap_ros.localization.filter.fiducial_filter import FiducialFilter
from infomap_ros.localization.filter.invariant_state import InvariantState
from infomap_ros.localization.filter.motion_prior import MotionPrior
from infomap_ros.localization.filter.pose_hypothesis import Expectation

from .fiducial_scene import CAMERA, observe


def random_pose(rng: np.random.Generator, distance: float, turn: float) -> np.ndarray:
    """A pose, shape (4, 4), about so far from the identity."""
    rotation = Rotation.from_rotvec(rng.normal(size=3) * turn).as_matrix()
    return make_transform(rotation, rng.normal(size=3) * distance)


@pytest.mark.parametrize("turn", [0.01, 0.3, 1.0])
def test_the_expected_shift_leads_back_to_the_expected_pose(turn: float) -> None:
    rng = np.random.default_rng(1)
    start, motion = random_pose(rng, 3.0, 1.0), random_pose(rng, 0.2, 0.2)
    state = InvariantState(start, np.eye(6), 20)
    points = rng.normal(size=(4, 3)) + np.array([0.0, 0.0, 3.0])
    state.add_fiducials(np.arange(4), points, np.zeros((4, 3, 3)))
    fiducials = state.positions.copy()
    far = start @ motion @ random_pose(rng, 0.5, turn)
    expectation = Expectation.at(state, MotionPrior(motion, np.eye(6)), far)
    state.T_map_camera = far
    state.correct(expectation.noise @ expectation.shift)
    np.testing.assert_allclose(state.T_map_camera, start @ motion, atol=1e-9)
    np.testing.assert_allclose(state.positions, fiducials, atol=1e-9)


def test_a_second_look_at_few_points_in_a_corner_does_not_move_a_certain_pose() -> None:
    rng = np.random.default_rng(2)
    corner = rng.uniform([-1.2, -0.9, 3.0], [-0.7, -0.5, 3.3], (8, 3))
    for _ in range(10):
        pose_filter = FiducialFilter(CAMERA)
        pose_filter.start(np.eye(4), 1e-12 * np.eye(6))
        pose_filter.add(observe(corner, np.eye(4), rng))
        update = pose_filter.update(observe(corner, np.eye(4), rng))
        assert update.is_consistent
        np.testing.assert_allclose(pose_filter.pose[0], np.eye(4), atol=1e-5)
