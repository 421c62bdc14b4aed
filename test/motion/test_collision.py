"""Collision checks against coal's exact shapes and against scenes with known answers."""

from __future__ import annotations

from itertools import pairwise

import coal
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from infomap_ros.errors import ConfigError, InvalidInputError
from infomap_ros.geometry import make_transform
from infomap_ros.geometry.resources import find_share
from infomap_ros.mapping.distance_field import DistanceField, field_of_blocked
from infomap_ros.motion.collision.body import CollisionBody, CollisionConfig
from infomap_ros.motion.collision.checker import CollisionChecker
from infomap_ros.motion.collision.kernels import is_free
from infomap_ros.motion.robot.robot_model import RobotModel

from .bodies import CoalBody, compared_pairs, distance, rover

SIZE = 0.05
FIRST = np.array((-30, -30, -10))


@pytest.fixture(scope="module")
def robot() -> RobotModel:
    return rover()


@pytest.fixture(scope="module")
def body(robot: RobotModel) -> CollisionBody:
    return CollisionBody.from_robot(robot)


@pytest.fixture(scope="module")
def shapes(robot: RobotModel) -> CoalBody:
    return CoalBody(robot, find_share("config/rover.urdf").read_text("utf-8"))


def nothing() -> DistanceField:
    return field_of_blocked(np.zeros((60, 60, 50), bool), FIRST, SIZE, outside_is_free=True)


def random_arm(robot: RobotModel, rng: np.random.Generator, count: int) -> np.ndarray:
    return rng.uniform(robot.arm.lower, robot.arm.upper, (count, len(robot.arm)))


def test_never_free_where_coal_finds_links_in_contact(
    robot: RobotModel, body: CollisionBody, shapes: CoalBody, rng: np.random.Generator
) -> None:
    """And free wherever coal finds all of them farther apart than the cover can stick out."""
    checker = CollisionChecker(body, nothing())
    compared = {frozenset(pair) for pair in compared_pairs(body)}
    qs = random_arm(robot, rng, 400)
    free = checker.are_free(qs, np.eye(4))
    far = 2.0 * (body.config.tolerance + body.config.margin) + 0.002
    closest = np.full(len(qs), np.inf)
    for n, q in enumerate(qs):
        placed = shapes.place(robot.arm.by_name(q), np.eye(4))
        closest[n] = min(
            distance(a, b)
            for i, a in enumerate(placed)
            for b in placed[i + 1 :]
            if frozenset((a[0], b[0])) in compared
        )
    assert not (free & (closest <= 0.0)).any()
    assert free[closest > far].all()
    assert (closest <= 0.0).sum() > 50 and (closest > far).sum() > 20


def test_only_joined_links_and_those_of_one_body_are_not_compared(body: CollisionBody) -> None:
    compared = {frozenset(pair) for pair in compared_pairs(body)}
    arm = ["base_link", "arm_turret", "arm_upper", "arm_forearm", "arm_wrist"]
    for joined in pairwise(arm):
        assert frozenset(joined) not in compared
    assert frozenset(("arm_wrist", "stereo_link")) not in compared
    assert frozenset(("base_link", "front_left_wheel")) not in compared
    for apart in [
        ("arm_forearm", "stereo_link"),
        ("base_link", "arm_upper"),
        ("stereo_link", "rear_left_wheel"),
        ("arm_turret", "stereo_link"),
    ]:
        assert frozenset(apart) in compared


@pytest.mark.parametrize("wider", [0.0, 0.03])
def test_never_free_where_coal_finds_the_body_in_a_blocked_voxel_or_too_near(
    robot: RobotModel, body: CollisionBody, shapes: CoalBody, rng: np.random.Generator, wider: float
) -> None:
    blocked = np.zeros((60, 60, 50), bool)
    blocked[tuple(rng.integers(0, (60, 60, 50), (300, 3)).T)] = True
    field = field_of_blocked(blocked, FIRST, SIZE, outside_is_free=True)
    checker = CollisionChecker(body, field, wider=wider)
    cube = coal.Box(SIZE, SIZE, SIZE)
    cubes = [
        ("voxel", cube, coal.Transform3s(np.eye(3), place))
        for place in (np.argwhere(blocked) + FIRST + 0.5) * SIZE
    ]
    far = body.config.tolerance + body.config.margin + wider + 0.012
    moving = {body.links[number] for number in body.moving_links}
    seen = [0, 0]
    for q in random_arm(robot, rng, 150):
        tilt = Rotation.from_euler("xyz", rng.uniform(-0.4, 0.4, 3)).as_matrix()
        T_map_base = make_transform(tilt, rng.uniform(-0.3, 0.3, 3))
        links = [
            item for item in shapes.place(robot.arm.by_name(q), T_map_base) if item[0] in moving
        ]
        closest = min(distance(a, b) for a in links for b in cubes)
        touched = checker.contact(q, T_map_base)
        touches_map = "with the map" in touched
        if closest <= wider:
            assert touched
            seen[0] += 1
        if closest > far:
            assert not touches_map
            seen[1] += 1
    assert min(seen) > 10


def test_report_names_what_touches_what(body: CollisionBody) -> None:
    blocked = np.zeros((60, 60, 50), bool)
    blocked[36:] = True  # a wall from x = 0.3 on
    checker = CollisionChecker(body, field_of_blocked(blocked, FIRST, SIZE, outside_is_free=True))
    upright = np.zeros(4)
    assert not checker.contact(upright, np.eye(4))
    leaning = checker.contact([0.0, 1.2, 0.0, 0.0], np.eye(4))
    assert leaning.startswith("arm_upper with the map at (0.")
    folded = checker.contact([0.0, -1.9, -2.7, 1.5], np.eye(4))
    assert " with " in folded


def test_wheels_may_stand_on_the_ground_and_the_arm_may_not(body: CollisionBody) -> None:
    blocked = np.zeros((60, 60, 50), bool)
    blocked[:, :, :9] = True  # the ground up to z = -0.05, above the wheels' lowest points
    checker = CollisionChecker(body, field_of_blocked(blocked, FIRST, SIZE, outside_is_free=True))
    assert not checker.contact(np.zeros(4), np.eye(4))
    low = checker.contact([0.0, 1.7, 0.9, 0.0], np.eye(4))
    assert "with the map" in low


def test_base_is_not_compared_with_the_map(body: CollisionBody) -> None:
    blocked = np.zeros((60, 60, 50), bool)
    blocked[25, 30, 11] = True  # within base_link
    checker = CollisionChecker(body, field_of_blocked(blocked, FIRST, SIZE, outside_is_free=True))
    assert not checker.contact(np.zeros(4), np.eye(4))


def test_batch_agrees_with_single_checks(
    robot: RobotModel, body: CollisionBody, rng: np.random.Generator
) -> None:
    blocked = rng.random((60, 60, 50)) < 0.002
    checker = CollisionChecker(body, field_of_blocked(blocked, FIRST, SIZE))
    qs = random_arm(robot, rng, 60)
    poses = np.tile(np.eye(4), (60, 1, 1))
    poses[:, :3, 3] = rng.uniform(-0.3, 0.3, (60, 3))
    single = [not checker.contact(q, pose) for q, pose in zip(qs, poses, strict=True)]
    np.testing.assert_array_equal(checker.are_free(qs, poses), single)
    assert 0 < sum(single) < 60


def test_no_point_of_the_body_moves_farther_than_its_bound(
    robot: RobotModel, body: CollisionBody, rng: np.random.Generator
) -> None:
    starts, arrays = random_arm(robot, rng, 200), body.arrays
    link_of = np.repeat(np.arange(len(body.links)), np.diff(arrays.starts))
    for q in starts:
        step = rng.uniform(-0.05, 0.05, len(q))
        before, after = body.spheres(q, np.eye(4)), body.spheres(q + step, np.eye(4))
        moved = np.linalg.norm(after - before, axis=1)
        bound = (arrays.reach @ np.abs(step))[link_of]
        assert (moved <= bound + 1e-12).all()


@pytest.mark.parametrize("wider", [0.0, 0.03])
def test_segment_that_is_called_free_is_free_everywhere(
    robot: RobotModel, body: CollisionBody, rng: np.random.Generator, wider: float
) -> None:
    blocked = np.zeros((60, 60, 50), bool)
    blocked[tuple(rng.integers(0, (60, 60, 50), (40, 3)).T)] = True
    field = field_of_blocked(blocked, FIRST, SIZE, outside_is_free=True)
    checker = CollisionChecker(body, field, wider=wider)
    ends = random_arm(robot, rng, 400)
    free = 0
    for first, second in zip(ends[::2], ends[1::2], strict=True):
        touched = checker.contact_between(first, second, np.eye(4))
        dense = first + np.linspace(0, 1, 700)[:, None] * (second - first)
        if not touched:
            assert _free_of_voxels(body, field, dense, wider).all()
            free += 1
    assert free > 10


def _free_of_voxels(
    body: CollisionBody, field: DistanceField, qs: np.ndarray, wider: float
) -> np.ndarray:
    """Whether the moving links are farther than this from what is blocked; no other margin."""
    link_of = np.repeat(np.arange(len(body.links)), np.diff(body.arrays.starts))
    moving = np.isin(link_of, body.moving_links)
    spheres = np.stack([body.spheres(q, np.eye(4))[moving] for q in qs])
    clear = field.spheres_clear(spheres[..., :3].reshape(-1, 3), spheres[..., 3].ravel() + wider)
    return clear.reshape(len(qs), -1).all(axis=1)


def test_robot_beside_a_wall_may_leave_it_and_not_approach(body: CollisionBody) -> None:
    blocked = np.zeros((60, 60, 50), bool)
    blocked[33:] = True  # from x = 0.15 on: the upright arm at x = 0.1 touches it, by the map
    checker = CollisionChecker(body, field_of_blocked(blocked, FIRST, SIZE, outside_is_free=True))
    upright = np.zeros(4)
    assert checker.contact(upright, np.eye(4))
    space, places = checker.departure(upright, np.eye(4)), body.scratch()
    assert is_free(space, upright, space.T_map_base, places)
    assert is_free(space, np.array([0.0, -0.4, 0.0, 0.0]), space.T_map_base, places)
    assert not is_free(space, np.array([0.0, 0.1, 0.0, 0.0]), space.T_map_base, places)


def test_links_that_touch_may_part_and_not_close(body: CollisionBody) -> None:
    checker = CollisionChecker(body, nothing())
    folded = np.array([0.0, 0.0, 0.0, 1.2])  # the cameras near the forearm
    assert checker.contact(folded, np.eye(4)) == "arm_forearm with stereo_link"
    space, places = checker.departure(folded, np.eye(4)), body.scratch()
    assert is_free(space, folded, space.T_map_base, places)
    assert is_free(space, np.array([0.0, 0.0, 0.0, 1.0]), space.T_map_base, places)
    assert not is_free(space, np.array([0.0, 0.0, 0.0, 1.3]), space.T_map_base, places)


def wall_from(x: int) -> DistanceField:
    """A wall that begins at so many voxels."""
    blocked = np.zeros((60, 60, 50), bool)
    blocked[x - FIRST[0] :] = True
    return field_of_blocked(blocked, FIRST, SIZE, outside_is_free=True)


def test_beside_a_wall_each_link_may_be_as_near_to_it_as_it_is(
    body: CollisionBody, rng: np.random.Generator
) -> None:
    """A base that arrived 1 mm from a wall, within the margin, may move its arm, but no nearer."""
    here = np.zeros(4)
    qs = np.concatenate([here[None], rng.uniform(-0.5, 0.5, (400, 4))])
    qs[:, 0] *= 0.0  # the turret stays, which stands by other rules

    def clearances(q: np.ndarray) -> np.ndarray:
        reach = (body.spheres(q, np.eye(4))[:, (0, 3)]).sum(axis=1)
        return 0.2 - np.maximum.reduceat(reach, body.arrays.starts[:-1])[body.moving_links]

    plain = CollisionChecker(body, wall_from(4))
    standing = plain.standing(here, np.eye(4))
    least = np.minimum(clearances(here), body.config.margin)
    assert 0.0 < least.min() < 0.002
    expected = np.array([(clearances(q) >= least - 1e-9).all() for q in qs])
    apart = CollisionChecker(body, nothing()).are_free(qs, np.eye(4))
    np.testing.assert_array_equal(standing.are_free(qs, np.eye(4)), expected & apart)
    assert plain.contact(here, np.eye(4))
    assert 20 < np.count_nonzero(expected) < 380


def test_no_link_may_reach_into_what_the_map_shows_though_it_seems_to_be_there(
    body: CollisionBody,
) -> None:
    here = np.zeros(4)
    standing = CollisionChecker(body, wall_from(3)).standing(here, np.eye(4))
    assert "with the map" in standing.contact(here, np.eye(4))


def test_malformed_input_is_named(body: CollisionBody) -> None:
    checker = CollisionChecker(body, nothing())
    with pytest.raises(InvalidInputError, match="q"):
        checker.contact(np.zeros(3), np.eye(4))
    with pytest.raises(InvalidInputError, match="T_map_bases"):
        checker.are_free(np.zeros((2, 4)), np.zeros((3, 4, 4)))
    with pytest.raises(ConfigError, match="margin"):
        CollisionConfig(margin=-1.0)
