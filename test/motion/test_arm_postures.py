"""Postures of the arm, the driving posture, and places derived from them."""

from __future__ import annotations

import numpy as np
import pytest

from infomap_ros.geometry import PinholeCamera, make_transform, points_inside
from infomap_ros.motion.arm.arm_postures import (
    MOST_COVERED,
    ArmPostures,
    OwnView,
    driving_posture,
    sample_postures,
)
from infomap_ros.motion.collision.body import CollisionBody
from infomap_ros.motion.collision.checker import CollisionChecker

from .bodies import rover
from .known_robots import tiago
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
    assert (away <= radii).all() and radii.max() == postures.radii.max() < 1.0
    assert (postures.radius_for(np.array([3.0, -2.0]), np.zeros(2)) == 0.0).all()


def test_postures_touch_nothing_of_the_robot(body: CollisionBody, postures: ArmPostures) -> None:
    checker = CollisionChecker(body, field_where(lambda x, y, z: x > 1.9))
    assert checker.are_free(postures.q, np.eye(4)).all()


def test_driving_posture_is_low_and_over_the_base(body: CollisionBody) -> None:
    """Lower than half of the upright arm, and within the wheels' outline as seen from above."""
    q = driving_posture(body)
    checker = CollisionChecker(body, field_where(lambda x, y, z: x > 1.9))
    assert not checker.contact(q, np.eye(4))
    moving = np.repeat(body.arrays.bodies > 0, np.diff(body.arrays.starts))
    spheres = body.spheres(q, np.eye(4))[moving]
    assert (spheres[:, 2] + spheres[:, 3]).max() < 0.5
    assert (np.abs(spheres[:, :2]) + spheres[:, 3:]).max() < 0.3
    np.testing.assert_array_equal(driving_posture(body), q)


def test_what_the_robot_covers_of_the_image_is_what_rays_at_its_shapes_say(
    body: CollisionBody,
) -> None:
    """Against places along more rays, at each of which the solids of the description are asked."""
    camera, chain = PinholeCamera(320, 240, 190.0, 190.0, 159.5, 119.5), body.chain
    view = OwnView.of(body, camera)
    qs = sample_postures(body, 3000)
    covered = view.covered(qs)
    u, v = np.meshgrid(np.arange(8.0, 320.0, 16.0), np.arange(8.0, 240.0, 16.0))
    ends = np.stack([(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, np.ones_like(u)], -1)
    ends = 2.0 * ends.reshape(-1, 3)
    carried = body.robot.model.getJointId(chain.joint_names[-1])
    tried = [*np.argsort(covered)[-400::80], *np.argsort(covered)[::800]]
    for q, share in zip(qs[tried], covered[tried], strict=True):
        joints = {j.name: float(np.clip(0.0, j.lower, j.upper)) for j in body.robot.joints}
        joints |= chain.by_name(q)
        solids = body.robot.solids_in(body.robot.camera_frame, joints)
        links = {shape.link for shape in body.robot.shapes if shape.joint != carried}
        along = np.linspace(0.0, 1.0, 400)[:, None, None] * ends
        seen = [each for each in solids if each.name in links]
        met = points_inside(along.reshape(-1, 3), seen, 0.0).reshape(400, -1).any(axis=0)
        assert met.mean() - 0.03 <= share <= met.mean() + 0.15
    assert covered.max() > 0.5 and (covered == 0.0).mean() > 0.5


def test_postures_in_which_the_camera_sees_mostly_the_robot_are_left_out(
    body: CollisionBody, postures: ArmPostures
) -> None:
    view = OwnView.of(body, PinholeCamera(320, 240, 190.0, 190.0, 159.5, 119.5))
    kept = ArmPostures.of(body, 3000, view)
    assert 0.7 * len(postures.q) < len(kept.q) < len(postures.q)
    assert view.covered(kept.q).max() <= MOST_COVERED == kept.most_covered


def test_the_camera_looks_ahead_while_a_robot_drives() -> None:
    """By the kinematics of Pinocchio: the compactest posture of TIAGo looks at the floor below."""
    robot = tiago()
    q = driving_posture(CollisionBody.from_robot(robot))
    resting = {joint.name: min(max(0.0, joint.lower), joint.upper) for joint in robot.joints}
    pose = robot.forward_kinematics(resting | robot.arm.by_name(q), robot.camera_frame)
    assert abs(pose[2, 2]) < 0.4
