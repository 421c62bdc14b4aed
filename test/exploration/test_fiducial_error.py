"""The localization error of the rating, from fiducials."""

from __future__ import annotations

import numpy as np

from infomap_ros.exploration.fiducial_error import FiducialLocalizationError
from infomap_ros.geometry import PinholeCamera, StereoRig, make_transform
from infomap_ros.localization.filter.config import Fiducials
from infomap_ros.mapping import VoxelMap
from infomap_ros.views.ranking.terms import OdometryDrift
from infomap_ros.views.situation import Situation

CAMERA = PinholeCamera(512, 384, 340.0, 340.0, 255.5, 191.5)
RIG = StereoRig(CAMERA, CAMERA, 0.12)
FORWARD = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
COVARIANCE = np.diag([9e-4] * 3 + [1e-5] * 3)


def situation() -> Situation:
    return Situation(VoxelMap(), CAMERA, 4.0, make_transform(FORWARD, (0, 0, 0.8)), COVARIANCE)


def views() -> np.ndarray:
    """One ahead, one behind that looks the other way."""
    about = FORWARD * ((-1.0,), (-1.0,), (1.0,))
    return np.stack([make_transform(FORWARD, (1, 0, 0.8)), make_transform(about, (-1, 0, 0.8))])


def known(points: np.ndarray) -> Fiducials:
    return Fiducials(np.arange(len(points)), points, np.tile(1e-6 * np.eye(3), (len(points), 1, 1)))


class Wall:
    """Good fiducials ahead; counts how often it is asked."""

    def __init__(self) -> None:
        self.asked = 0
        y, z = np.meshgrid(np.linspace(-0.8, 0.8, 4), np.linspace(0.3, 1.3, 3))
        self.points = np.column_stack([np.full(y.size, 3.0), y.ravel(), z.ravel()])

    def __call__(self) -> Fiducials:
        self.asked += 1
        return known(self.points)


def test_good_fiducials_ahead_make_the_pose_better_than_it_is() -> None:
    error = FiducialLocalizationError(RIG, Wall())
    ahead, behind = error(situation(), views(), np.ones(2))
    assert ahead < -0.02
    # Behind nothing is known: what is found there carries the pose along, and does not mend it.
    assert behind > 0.1 * ahead


def test_without_fiducials_it_is_of_the_size_of_odometry_drift() -> None:
    nothing = known(np.empty((0, 3)))
    error, drift = FiducialLocalizationError(RIG, lambda: nothing), OdometryDrift()
    poses = np.stack([make_transform(FORWARD, (distance, 0, 0.8)) for distance in (0.5, 1.0, 2.0)])
    arguments = situation(), poses, np.array([0.5, 1.0, 2.0])
    ratios = error(*arguments) / drift(*arguments)
    # Drift counts its sigma once, not along each axis, and of the rotation only the heading.
    assert ((ratios > 1.0) & (ratios < 3.0)).all()


def test_fiducials_are_asked_for_once_for_each_choice() -> None:
    wall = Wall()
    error = FiducialLocalizationError(RIG, wall)
    first, second = situation(), situation()
    for now in (first, first, second, second):
        error(now, views(), np.ones(2))
    assert wall.asked == 2
    assert error.model == "12 fiducials"


def test_where_nothing_localizes_by_fiducials_it_is_odometry_drift() -> None:
    error, drift = FiducialLocalizationError(RIG, lambda: None), OdometryDrift()
    arguments = situation(), views(), np.ones(2)
    np.testing.assert_array_equal(error(*arguments), drift(*arguments))
    assert error.model == "odometry drift"
