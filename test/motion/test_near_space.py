"""What counts as free around a robot in a map that knows little."""

from __future__ import annotations

import numpy as np
import pytest

from infomap_ros.geometry import Cylinder, PlacedSolid, make_transform
from infomap_ros.mapping import VoxelMap
from infomap_ros.motion.arm.arm_path import plan_arm_path
from infomap_ros.motion.collision.body import CollisionBody
from infomap_ros.motion.collision.checker import NearSpace

from .bodies import rover
from .scenes import map_where

BASE = make_transform(np.eye(3), (0.3, -0.2, 0.1))


@pytest.fixture(scope="module")
def body() -> CollisionBody:
    return CollisionBody.from_robot(rover())


def space(body: CollisionBody, voxel_map: VoxelMap, **options: object) -> NearSpace:
    joints = {joint.name: 0.0 for joint in body.robot.joints}
    arguments = {"radius": 1.2, "clear_body": 0.05} | options
    return NearSpace(voxel_map, body, BASE, joints, **arguments)  # type: ignore[arg-type]


def nothing_known() -> VoxelMap:
    return map_where(lambda x, y, z: z < 5, lambda x, y, z: z < -0.45)


def test_body_and_a_little_around_it_are_free(body: CollisionBody) -> None:
    checker = space(body, nothing_known()).checker_at(BASE)
    assert not checker.contact(np.zeros(4), BASE)
    spheres = body.spheres(np.zeros(4), BASE)
    away = checker.field.clearances(spheres[:, :3], 0.5) - spheres[:, 3]
    assert away.min() >= 0.05 - body.config.tolerance - 1e-6
    assert checker.contact([0.0, 1.0, 0.0, 0.0], BASE)


def test_declared_space_is_free(body: CollisionBody) -> None:
    declared = PlacedSolid(Cylinder(1.2, 2.4), BASE)
    checker = space(body, nothing_known(), known_free=(declared,)).checker_at(BASE)
    assert not checker.contact([0.0, 1.0, 0.0, 0.0], BASE)


def test_what_was_seen_in_declared_space_still_blocks(body: CollisionBody) -> None:
    post = map_where(
        lambda x, y, z: np.hypot(x - 0.8, y + 0.2) < 0.1,
        lambda x, y, z: np.hypot(x - 0.8, y + 0.2) < 0.1,
    )
    declared = PlacedSolid(Cylinder(1.2, 2.4), BASE)
    checker = space(body, post, known_free=(declared,)).checker_at(BASE)
    assert "with the map at" in checker.contact([0.0, 1.3, 0.0, 0.0], BASE)


def test_robot_that_was_mapped_as_an_obstacle_can_move_away(body: CollisionBody) -> None:
    """The cameras have seen the robot's own forearm, upright at x = 0.4."""

    def forearm(x, y, z):
        return (np.hypot(x - 0.4, y + 0.2) < 0.04) & (abs(z - 0.8) < 0.04)

    seen = map_where(forearm, lambda x, y, z: z > -1.0)
    checker = space(body, seen).checker_at(BASE)
    assert checker.field.clearances([(0.41, -0.19, 0.81)], 1.0)[0] > 0.0
    path = plan_arm_path(checker, np.zeros(4), [0.0, -0.8, 0.3, 0.0], BASE)
    assert path.converged, path.reason


def test_checker_of_a_place_is_remembered(body: CollisionBody) -> None:
    near = space(body, nothing_known())
    assert near.checker_at(BASE) is near.checker_at(BASE.copy())
    assert near.checker_at(BASE) is not near.checker_at(np.eye(4))


def test_what_was_mapped_at_the_foot_of_the_arm_does_not_hold_the_arm(body: CollisionBody) -> None:
    """Specks at its turret, as a camera leaves that looked at its own base from too near."""
    turret = body.links.index("arm_turret")
    spheres = body.spheres(np.zeros(4), BASE)[slice(*body.arrays.starts[turret : turret + 2])]
    middle = spheres[:, :3].mean(axis=0)

    def speck(x, y, z):
        away = np.linalg.norm(np.stack(np.broadcast_arrays(x, y, z)) - middle[:, None], axis=0)
        return (away > 0.04) & (away < 0.1) & (x < middle[0] - 0.03) & (z < middle[2])

    seen = map_where(speck, lambda x, y, z: z > -1.0)
    goal = np.array([1.5, -0.8, 0.3, 0.0])
    here = space(body, seen)
    assert here.checker_around(BASE[None]).contact(goal, BASE).startswith("arm_turret with the map")
    path = plan_arm_path(here.checker_at(BASE), np.zeros(4), goal, BASE)
    assert path.converged, path.reason
    # Nothing else may touch them, nor may the foot stand where they are.
    wall = map_where(lambda x, y, z: x > 0.9, lambda x, y, z: z > -1.0)
    assert space(body, wall).checker_at(BASE).contact([0.0, 1.4, 0.0, 0.0], BASE)
    beside = BASE @ make_transform(np.eye(3), (-0.1, 0.0, 0.0))
    assert here.checker_at(beside).contact(goal, beside)
