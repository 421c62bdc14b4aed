"""The way back along which the arm has come."""

from __future__ import annotations

import numpy as np
import pytest

from infomap_ros.geometry import make_transform
from infomap_ros.motion.arm.arm_path import time_path
from infomap_ros.motion.reaching import WholeBodyReach
from infomap_ros.motion.route import ArmPath, Route
from infomap_ros.motion.route_planner import ArmTrail, corners_of

from .bodies import rover
from .scenes import map_where

BASE = make_transform(np.eye(3), (0.0, 0.0, 0.0762))
ROBOT = rover()
NAMES = ROBOT.arm.joint_names
A, B, C = np.zeros(4), np.array([0.5, 0.5, 0.0, 0.0]), np.array([0.5, -0.5, 1.0, 0.3])


def arm_path(*corners: np.ndarray) -> ArmPath:
    return time_path(ROBOT.arm, np.stack(corners))


def route(before: ArmPath, after: ArmPath, drives: bool = False) -> Route:
    count = 3 if drives else 0
    poses = np.tile(np.eye(4), (count, 1, 1))
    return Route(before, np.zeros((count, 3)), poses, after, np.eye(4))


def staying(q: np.ndarray) -> ArmPath:
    return ArmPath.staying(NAMES, q)


def test_corners_of_a_timed_path_are_those_it_was_made_of() -> None:
    np.testing.assert_allclose(corners_of(arm_path(A, B, C, A).positions), [A, B, C, A], atol=1e-12)
    np.testing.assert_array_equal(corners_of(A[None]), [A])
    np.testing.assert_array_equal(corners_of(np.stack([A, B, A])), [A, B, A])


def test_trail_grows_while_the_base_stands() -> None:
    trail = ArmTrail.at(BASE, A)
    trail = trail.after(BASE, B, route(staying(A), arm_path(A, B)))
    trail = trail.after(BASE, C, route(staying(B), arm_path(B, C)))
    np.testing.assert_allclose(trail.back(), [C, B, A], atol=1e-12)


def test_motion_left_in_the_middle_is_gone_back_from_there() -> None:
    half = 0.5 * (B + C)
    trail = ArmTrail.at(BASE, A).after(BASE, half, route(staying(A), arm_path(A, B, C)))
    np.testing.assert_allclose(trail.back(), [half, B, A], atol=1e-12)


def test_trail_begins_anew_where_the_base_has_driven() -> None:
    trail = ArmTrail.at(BASE, A)
    there = make_transform(np.eye(3), (1.0, 0.0, 0.0))
    trail = trail.after(there, C, route(arm_path(A, B), arm_path(B, C), drives=True))
    np.testing.assert_allclose(trail.back(), [C, B], atol=1e-12)


def test_drive_that_failed_leaves_the_folded_arm() -> None:
    trail = ArmTrail.at(BASE, A)
    there = make_transform(np.eye(3), (0.4, 0.0, 0.0))
    trail = trail.after(there, B, route(arm_path(A, B), arm_path(B, C), drives=True))
    np.testing.assert_allclose(trail.back()[0], B)
    assert len(np.unique(trail.positions.round(6), axis=0)) == 1


@pytest.mark.parametrize("moved", [(0.3, 0.0, 0.0), (0.0, 0.0, 0.0)])
def test_nothing_is_known_of_an_arm_or_base_that_others_moved(moved: tuple[float, ...]) -> None:
    trail = ArmTrail.at(BASE, A).after(BASE, B, route(staying(A), arm_path(A, B)))
    there = BASE @ make_transform(np.eye(3), moved)
    trail = trail.after(there, B if any(moved) else C, None)
    assert len(trail.positions) == 1


def test_pose_that_is_corrected_a_little_keeps_the_trail() -> None:
    trail = ArmTrail.at(BASE, A).after(BASE, B, route(staying(A), arm_path(A, B)))
    corrected = BASE @ make_transform(np.eye(3), (0.02, -0.01, 0.005))
    trail = trail.after(corrected, B, None)
    np.testing.assert_allclose(trail.back()[[0, -1]], [B, A], atol=1e-12)
    np.testing.assert_array_equal(trail.T_map_base, corrected)


def test_arm_folds_the_way_it_came_where_the_map_has_closed_around_it() -> None:
    """The robot unfolds; then the map holds that nothing around the arm is known to be free."""
    joints = {joint.name: 0.0 for joint in ROBOT.joints}
    open_map = map_where(lambda x, y, z: z < 0.0, lambda x, y, z: z < 9.0)
    closed = map_where(lambda x, y, z: z < 0.0, lambda x, y, z: (z < 0.0) | (np.hypot(x, y) > 0.9))
    first = WholeBodyReach(ROBOT, open_map, BASE, joints)
    folded = first._whole.driving
    joints |= ROBOT.arm.by_name(folded)
    first = WholeBodyReach(ROBOT, open_map, BASE, joints)
    view = BASE @ ROBOT.arm.camera_pose([0.3, 0.9, 0.4, -0.6])
    sent = first.reach(view).route
    assert sent is not None and not sent.moves_base
    joints |= ROBOT.arm.by_name(sent.arm_after.positions[-1])

    lost = WholeBodyReach(ROBOT, closed, BASE, joints)  # nothing is known of the way back
    here = ROBOT.arm.positions(joints)
    np.testing.assert_allclose(lost._whole.driving, here)
    outline = np.abs(lost._whole.body.spheres(here, np.eye(4))[:, :2]).max()
    assert lost._whole.base_radius > outline > 1.1 * first._whole.base_radius
    after = WholeBodyReach(ROBOT, closed, BASE, joints, previous=first, sent=sent)
    np.testing.assert_allclose(after._whole.driving, folded)
    back = after._routes._folding.positions
    np.testing.assert_allclose(
        corners_of(back), corners_of(sent.arm_after.positions)[::-1], atol=1e-9
    )


def test_who_stands_folded_as_exactly_as_encoders_tell_may_drive_whatever_the_map_says() -> None:
    """A few voxels at the camera say that the posture to drive in touches something."""
    joints = {joint.name: 0.0 for joint in ROBOT.joints}
    open_map = map_where(lambda x, y, z: z < 0.0, lambda x, y, z: z < 9.0)
    folded = WholeBodyReach(ROBOT, open_map, BASE, joints)._whole.driving
    camera = (BASE @ ROBOT.arm.camera_pose(folded))[:3, 3]

    def solid(x: np.ndarray, y: np.ndarray, z: np.ndarray) -> np.ndarray:
        return (z < 0.0) | (np.abs(np.stack([x, y, z], -1) - camera).max(-1) < 0.1)

    spotted = map_where(solid, lambda x, y, z: z < 9.0)
    standing = joints | ROBOT.arm.by_name(folded + 5e-4)
    reach = WholeBodyReach(ROBOT, spotted, BASE, standing)
    assert not reach._routes.arm(folded + 0.1, folded, BASE).converged
    folding = reach._routes._folding
    assert folding.converged and not folding.moves
