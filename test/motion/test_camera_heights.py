"""Where the rover can hold its camera, by its printed dimensions."""

from __future__ import annotations

import numpy as np
import pytest

from infomap_ros.geometry import make_transform
from infomap_ros.geometry.resources import find_share
from infomap_ros.motion.base.standing_ground import ClearStart
from infomap_ros.motion.robot.robot_model import RobotModel
from infomap_ros.motion.robot.solid_extent import camera_heights, random_postures, robot_bottom

WHEEL_RADIUS, SHOULDER, UPPER, FOREARM, WRIST = 0.0762, 0.11 + 0.1382, 0.3442, 0.2286, 0.0893


@pytest.fixture(scope="module")
def rover() -> RobotModel:
    return RobotModel.from_urdf(
        find_share("config/rover.urdf"), "left_camera_optical_frame", "base_link"
    )


def test_lowest_point_is_that_of_the_wheels(rover: RobotModel) -> None:
    assert robot_bottom(rover) == pytest.approx(-WHEEL_RADIUS, abs=1e-6)


def test_highest_camera_is_that_of_the_stretched_arm(rover: RobotModel) -> None:
    low, high = camera_heights(rover)
    stretched = WHEEL_RADIUS + SHOULDER + UPPER + FOREARM + WRIST
    assert stretched - 0.06 < high <= stretched
    assert low == pytest.approx(0.15)


def test_postures_keep_the_limits(rover: RobotModel) -> None:
    postures = random_postures(rover, 500, np.random.default_rng(1))
    assert (postures >= rover.arm.lower).all() and (postures <= rover.arm.upper).all()
    assert np.ptp(postures, axis=0) == pytest.approx(rover.arm.upper - rover.arm.lower, rel=0.05)


def test_clear_start_stands_on_the_ground_about_the_base(rover: RobotModel) -> None:
    T_map_base = make_transform(np.eye(3), (2.0, 1.0, 0.5))
    space = ClearStart(T_map_base, 0.9).space(rover)
    ground = 0.5 - WHEEL_RADIUS
    high = ground + camera_heights(rover)[1]
    inside = [(2.0, 1.0, ground + 0.01), (2.85, 1.0, high), (2.0, 0.2, ground + 0.5)]
    outside = [(2.0, 1.0, ground - 0.01), (2.95, 1.0, ground + 0.3), (2.0, 1.0, high + 0.2)]
    local = np.array([*inside, *outside]) - space.transform[:3, 3]
    assert (space.solid.signed_distance(local) <= 0.0).tolist() == [True] * 3 + [False] * 3
