"""Postures of the arm, the driving posture, and places derived from them."""

from __future__ import annotations

import numpy as np
import pytest

from infomap_ros.geometry import make_transform
from infomap_ros.motion.arm.arm_postures import ArmPostures
from infomap_ros.motion.arm.driving_posture import driving_posture
from infomap_ros.motion.collision.checker import CollisionBody, CollisionChecker

from .bodies import rover
from .scenes import field_where


@pytest.fixture(scope="module")
def body() -> CollisionBody:
    return CollisionBody.from_robot(rover())


@pytest.fixture(scope="module")
def postures(body: CollisionBody) -> ArmPostures:
    return ArmPostures.of(body, 3000)


def yawed(place: np.ndarray, height: float) -> np.ndarray:
    x, y, yaw = place
    turn = [[np.cos(yaw), -np.sin(yaw), 0], [np.sin(yaw), np.cos(yaw), 0], [0, 0, 1]]
    return make_transform(turn, (x, y, height))


def test_places_bring_the_camera_to_the_view(body: CollisionBody, postures: ArmPostures) -> None:
    """Exactly in position and azimuth, and in steepness within the tolerance."""
    direction = np.array([np.cos(2.0) * np.cos(0.3), np.sin(2.0) * np.cos(0.3), -np.sin(0.3)])
    view = make_transform(np.eye(3), (1.0, -2.0, 0.6))
    view[:3, 2] = direction
    places, heights, rows = postures.places_for(view, 0.1)
    assert len(places) > 50
    for place, height, row in list(zip(places, heights, rows, strict=True))[:50]:
        camera = yawed(place, height) @ body.chain.camera_pose(postures.q[row])
        np.testing.assert_allclose(camera[:3, 3], view[:3, 3], atol=1e-9)
        level = camera[:2, 2] / np.linalg.norm(camera[:2, 2])
        np.testing.assert_allclose(level, (np.cos(2.0), np.sin(2.0)), atol=1e-9)
        assert abs(np.arcsin(camera[2, 2]) + 0.3) <= 0.1 + 1e-9


def test_no_posture_reaches_beyond_the_radius_of_its_height_and_steepness(
    postures: ArmPostures,
) -> None:
    away = np.linalg.norm(postures.positions[:, :2], axis=1)
    radii = postures.radius_for(postures.positions[:, 2], postures.steepness)
    assert (away <= radii).all() and radii.max() == postures.farthest < 1.0
    assert (postures.radius_for(np.array([3.0, -2.0]), np.zeros(2)) == 0.0).all()


def test_postures_touch_nothing_of_the_robot(body: CollisionBody, postures: ArmPostures) -> None:
    checker = CollisionChecker(body, field_where(lambda x, y, z: x > 1.9))
    assert checker.are_free(postures.q, np.eye(4)).all()


def test_driving_posture_is_low_and_over_the_base(body: CollisionBody) -> None:
    """Lower than half of the upright arm, and within the wheels' outline as seen from above."""
    q = driving_posture(body)
    checker = CollisionChecker(body, field_where(lambda x, y, z: x > 1.9))
    assert checker.check(q, np.eye(4)).free
    moving = np.repeat(body.arrays.bodies > 0, np.diff(body.arrays.starts))
    spheres = body.spheres(q, np.eye(4))[moving]
    assert (spheres[:, 2] + spheres[:, 3]).max() < 0.5
    assert (np.abs(spheres[:, :2]) + spheres[:, 3:]).max() < 0.3
    np.testing.assert_array_equal(driving_posture(body), q)
