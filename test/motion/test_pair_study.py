"""Links that nearly touch by design do not keep robots from moving."""

from __future__ import annotations

from functools import cache

import coal
import numpy as np
import pinocchio
import pytest

from infomap_ros.errors import ConfigError
from infomap_ros.geometry import make_transform
from infomap_ros.mapping.distance_field import field_of_blocked
from infomap_ros.motion.arm.arm_path import plan_arm_path
from infomap_ros.motion.arm.arm_postures import compact_postures, driving_posture
from infomap_ros.motion.collision.body import CollisionBody, CollisionConfig
from infomap_ros.motion.collision.checker import CollisionChecker
from infomap_ros.motion.collision.kernels import is_free
from infomap_ros.motion.robot.robot_model import RobotModel

from .bodies import compared_pairs
from .known_robots import TELESCOPE, TIAGO_ARM, panda, stretch, tiago, ur5

BASE = make_transform(np.eye(3), [0.0, 0.0, 0.0])
ROBOTS = {
    "panda": panda,
    "ur5": ur5,
    "tiago": lambda: tiago(arm_joints=TIAGO_ARM),
    "stretch": lambda: stretch(mimics=TELESCOPE),
}


@cache
def checker_of(name: str) -> CollisionChecker:
    nothing = field_of_blocked(np.zeros((4, 4, 4), bool), (0, 0, 0), 0.05, outside_is_free=True)
    return CollisionChecker(CollisionBody.from_robot(ROBOTS[name]()), nothing)


def random_configurations(robot: RobotModel, rng: np.random.Generator, count: int) -> np.ndarray:
    return rng.uniform(robot.arm.lower, robot.arm.upper, (count, len(robot.arm)))


def touching(robot: RobotModel, q: np.ndarray) -> set[frozenset[str]]:
    """Links whose collision meshes meet, by coal, placed by Pinocchio."""
    data = robot.model.createData()
    pinocchio.forwardKinematics(robot.model, data, robot.mechanism.resting(robot.arm.by_name(q)))
    placed = []
    for shape in robot.shapes:
        pose = data.oMi[shape.joint].homogeneous @ shape.placement
        placed.append((shape.link, shape.geometry, coal.Transform3s(pose[:3, :3], pose[:3, 3])))
    return {
        frozenset((a[0], b[0]))
        for i, a in enumerate(placed)
        for b in placed[i + 1 :]
        if a[0] != b[0]
        and coal.collide(*a[1:], *b[1:], coal.CollisionRequest(), coal.CollisionResult())
    }


@pytest.mark.parametrize("name", ROBOTS)
def test_what_is_free_touches_nothing_that_is_compared(name, rng):
    checker = checker_of(name)
    robot = checker.body.robot
    compared = {frozenset(pair) for pair in compared_pairs(checker.body)}
    qs = random_configurations(robot, rng, 60)
    free = checker.are_free(qs, BASE)
    contact = np.array([bool(touching(robot, q) & compared) for q in qs])
    assert not (free & contact).any()
    assert free.sum() >= 0.6 * (~contact).sum()


@pytest.mark.parametrize("name", ["ur5", "stretch"])
def test_the_posture_to_drive_in_truly_touches_nothing(name):
    """Which is the least of thousands, and so the likeliest to be just what spheres do not tell."""
    body = checker_of(name).body
    compared = {frozenset(pair) for pair in compared_pairs(body)}
    for q in (driving_posture(body), *compact_postures(body, 3)):
        assert not touching(body.robot, q) & compared


@pytest.mark.parametrize("name", ["panda", "ur5", "tiago"])
def test_links_that_are_not_compared_are_joined_or_touch_at_rest_or_mostly(name, rng):
    checker = checker_of(name)
    robot, tree = checker.body.robot, checker.body.tree
    compared = {frozenset(pair) for pair in compared_pairs(checker.body)}
    carrier = [0, *tree.arrays.parents]
    body_of = {shape.link: int(tree.bodies[shape.joint]) for shape in robot.shapes}
    rest = np.array([robot.joint(joint).rest for joint in robot.arm.joint_names])
    left_out = [touching(robot, q) - compared for q in random_configurations(robot, rng, 40)]
    for pair in set().union(*left_out) - touching(robot, rest):
        first, second = (body_of[link] for link in pair)
        joined = second in (first, carrier[first]) or first == carrier[second]
        assert joined or sum(pair in one for one in left_out) > 12, pair


@pytest.mark.parametrize("name", ROBOTS)
def test_ways_of_the_arm_are_found(name, rng):
    checker = checker_of(name)
    qs = random_configurations(checker.body.robot, rng, 60)
    qs = qs[checker.are_free(qs, BASE)][:8]
    paths = [plan_arm_path(checker, a, b, BASE) for a, b in zip(qs[::2], qs[1::2], strict=True)]
    assert sum(path.converged for path in paths) >= 3
    space, scratch = checker.space(BASE), checker.body.scratch()
    space = space._replace(gaps=space.gaps - space.kept - 1e-9)  # the margin itself may be used up
    for path in paths:
        assert all(is_free(space, q, space.T_map_base, scratch) for q in path.positions)


@pytest.mark.parametrize("name", ["panda", "ur5", "tiago"])
def test_a_robot_at_rest_is_free(name):
    checker = checker_of(name)
    robot = checker.body.robot
    rest = [robot.joint(joint).rest for joint in robot.arm.joint_names]
    assert checker.contact(rest, BASE) == ""


def test_stretch_is_free_with_its_arm_raised():
    checker = checker_of("stretch")
    touched = checker.contact([0.6, 0.1, 0.5, 0.0, 0.0], BASE)
    assert touched == ""


def test_contacts_can_be_allowed():
    config = CollisionConfig(allowed_contacts=("panda_link[01]:panda_link5",))
    body = CollisionBody.from_robot(panda(), config)
    before = set(compared_pairs(checker_of("panda").body))
    after = set(compared_pairs(body))
    assert before - after == {
        ("panda_link0", "panda_link5"), ("panda_link1", "panda_link5"),
    }  # fmt: skip


@pytest.mark.parametrize("contact", ["panda_link1", "a:b:c"])
def test_a_malformed_contact_is_refused(contact):
    with pytest.raises(ConfigError, match="allowed_contacts"):
        CollisionConfig(allowed_contacts=(contact,))
