"""No part of the base enters a keep-out region or leaves a fence, by its collision shapes."""

from __future__ import annotations

import numpy as np
import pytest

from infomap_ros.geometry import Polygon
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.mapping.terrain.terrain import Terrain
from infomap_ros.motion.base.base_planner import BasePlanner, LeavingPlanner
from infomap_ros.motion.base.drive_space import BasePath, BasePlannerConfig
from infomap_ros.motion.base.path_following import PathFollowingConfig, drive_seconds
from infomap_ros.motion.base.vehicle import Vehicle
from infomap_ros.motion.keep_out import KeepOut, with_closed_ground, with_keep_out

from .grounds import FOLDED, ground, plane, rover, rover_model, stance_of
from .polygons import footprint_points, placed, winding_inside

HALF = 2.6
LEVEL = plane(0.0, 0.0)
BLOCK = Polygon.of([(0.6, -0.7), (1.1, -0.8), (1.2, 0.9), (0.5, 0.6)], "stairs")
CORNER = Polygon.of([(-1.5, 0.5), (-0.6, 0.5), (-0.6, 0.9), (-1.1, 0.9), (-1.1, 1.6), (-1.5, 1.6)])
FENCE = Polygon.of([(-2.2, -1.6), (2.3, -1.7), (2.2, 1.9), (-2.0, 1.8)], "yard")
RULES = KeepOut((BLOCK, CORNER), (FENCE,))


@pytest.fixture(scope="module")
def vehicle() -> Vehicle:
    return rover()


@pytest.fixture(scope="module")
def footprint() -> FloatArray:
    joints = {joint.name: 0.0 for joint in rover_model().joints} | FOLDED
    return footprint_points(rover_model(), joints)


@pytest.fixture(scope="module")
def terrain() -> Terrain:
    return ground(LEVEL, HALF)


def broken(path: FloatArray, footprint: FloatArray, rules: KeepOut) -> np.ndarray:
    """Poses of a path, shape (K, 3), at which some point of the body is where it must not be."""
    bad = np.zeros(len(path), bool)
    for row, pose in enumerate(path):
        points = placed(footprint, *pose)
        bad[row] = any(winding_inside(points, each.corners).any() for each in rules.regions)
        bad[row] |= any(not winding_inside(points, each.corners).all() for each in rules.fences)
    return bad


def places(seed: int, count: int) -> FloatArray:
    rng = np.random.default_rng(seed)
    return np.column_stack(
        [rng.uniform(-1.8, 1.9, count), rng.uniform(-1.3, 1.5, count), rng.uniform(-3, 3, count)]
    )


@pytest.mark.parametrize("samples", [0, 2000])
@pytest.mark.parametrize("turning_radius", [0.0, 0.6])
def test_no_pose_of_a_path_breaks_a_rule(
    terrain: Terrain, vehicle: Vehicle, footprint: FloatArray, samples: int, turning_radius: float
) -> None:
    """By the lattice alone and with OMPL; without rules some of these paths would."""
    config = BasePlannerConfig(turning_radius=turning_radius)
    kept = BasePlanner(with_keep_out(terrain, RULES), vehicle, config)
    free = BasePlanner(terrain, vehicle, config)
    start, complete, would, methods = np.array([-0.3, -0.3, 0.2]), 0, 0, set()
    assert not broken(start[None], footprint, RULES).any()
    for goal in places(7, 20):
        path = kept.plan(start, goal, samples)
        assert not broken(path.poses, footprint, RULES).any()
        complete += path.complete
        methods.add(path.method)
        would += broken(free.plan(start, goal, samples).poses, footprint, RULES).any()
        if not path.complete and path.reason.startswith("goal:"):
            assert "keep-out region" in path.reason or "geofence" in path.reason, path.reason
    assert complete >= 4 and would >= 4
    assert ("ompl" in methods) == (samples > 0)


def test_a_pose_is_refused_exactly_where_the_body_is_near(
    terrain: Terrain, vehicle: Vehicle, footprint: FloatArray
) -> None:
    """All that break a rule are refused, and none whose body is far enough off is.

    A column's middle may be 0.055 m beside the body with its margin, and a cell is closed where any
    of its points is within 0.035 m of the region.
    """
    closed = with_keep_out(terrain, RULES)
    poses = places(3, 400)
    good = vehicle.stances(closed, poses).ok
    bad = broken(poses, footprint, RULES)
    assert not (good & bad).any()
    distances = [
        min(
            min(each.signed_distance(placed(footprint, *pose)).min() for each in RULES.regions),
            min(-each.signed_distance(placed(footprint, *pose)).max() for each in RULES.fences),
        )
        for pose in poses
    ]
    assert good[np.array(distances) > 0.165].all()
    assert 40 < good.sum() < 360


def test_the_reason_names_the_region(terrain: Terrain, vehicle: Vehicle) -> None:
    closed = with_keep_out(terrain, RULES)
    assert stance_of(vehicle, closed, 0.9, 0.0, 0.0).reason == (
        "the base would stand in or next to keep-out region 'stairs'"
    )
    outside = stance_of(vehicle, closed, 2.2, -1.0, 0.0).reason
    assert outside == "the base would stand outside or next to geofence 'yard'"
    assert stance_of(vehicle, closed, -0.3, -0.3, 0.0).ok
    path = BasePlanner(closed, vehicle).plan((-0.3, -0.3, 0.0), (0.9, 0.0, 0.0))
    assert not path.complete
    assert "in or next to keep-out region 'stairs'" in path.reason


def test_heights_stay_and_no_rule_changes_nothing(terrain: Terrain) -> None:
    np.testing.assert_array_equal(with_keep_out(terrain, RULES).heights, terrain.heights)
    assert with_keep_out(terrain, KeepOut()) is terrain
    far = Polygon.of([(50, 50), (51, 50), (51, 51)], "far")
    assert with_keep_out(terrain, KeepOut((far,))) is terrain


def leaving(terrain: Terrain, vehicle: Vehicle, inside: KeepOut, others: KeepOut) -> LeavingPlanner:
    return LeavingPlanner(
        with_keep_out(with_keep_out(terrain, others), inside),
        with_closed_ground(terrain, others.closed_ground(terrain)),
        vehicle,
        BasePlannerConfig(),
        None,
    )


def last_broken(path: BasePath, footprint: FloatArray, rules: KeepOut) -> int:
    """Row of the last pose that breaks a rule; none may before that not."""
    bad = broken(path.poses, footprint, rules)
    assert bad[0], "the robot begins inside"
    row = int(np.flatnonzero(bad)[-1])
    assert bad[: row + 1].all(), "it goes in again"
    return row


@pytest.mark.parametrize(
    ("start", "least"),
    [((0.0, 0.9, 1.5), 0.5), ((0.0, -0.9, 0.0), 0.5), ((-0.9, 0.0, 0.0), 0.5)],
)
def test_a_robot_leaves_a_region_by_the_shortest_path_and_stays_out(
    terrain: Terrain, vehicle: Vehicle, footprint: FloatArray, start: tuple, least: float
) -> None:
    square = Polygon.of([(-1.4, -1.4), (1.4, -1.4), (1.4, 1.4), (-1.4, 1.4)], "square")
    inside, goal = KeepOut((square,)), (2.0, -2.0, 0.0)
    planner = leaving(terrain, vehicle, inside, KeepOut())
    path = planner.plan(start, goal)
    assert path.complete, path.reason
    np.testing.assert_allclose(path.poses[-1, :2], goal[:2], atol=1e-6)
    row = last_broken(path, footprint, inside)
    out = path.poses[: row + 1]
    driven = np.hypot(*np.diff(out[:, :2], axis=0).T).sum()
    shortest = min(
        1.4 - abs(start[axis]) + np.abs(footprint).max(axis=0).min() for axis in range(2)
    )
    assert least < driven < shortest + 0.35
    assert planner.reachable_area(start).any()


def test_a_robot_that_leaves_one_region_stays_out_of_the_others(
    terrain: Terrain, vehicle: Vehicle, footprint: FloatArray
) -> None:
    """The nearest side is closed by another one: it leaves by the opposite side."""
    band = Polygon.of([(-0.8, -2.6), (0.8, -2.6), (0.8, 2.6), (-0.8, 2.6)], "band")
    shut = Polygon.of([(0.9, -2.6), (2.6, -2.6), (2.6, 2.6), (0.9, 2.6)], "shut")
    planner = leaving(terrain, vehicle, KeepOut((band,)), KeepOut((shut,)))
    path = planner.plan((0.3, 0.0, 0.0), (-1.7, 0.5, 0.0))
    assert path.complete, path.reason
    assert not broken(path.poses, footprint, KeepOut((shut,))).any()
    assert last_broken(path, footprint, KeepOut((band,))) > 0


def test_a_robot_outside_a_fence_comes_in_by_the_shortest_path_and_stays(
    terrain: Terrain, vehicle: Vehicle, footprint: FloatArray
) -> None:
    fence = Polygon.of([(-0.4, -2.0), (2.2, -2.0), (2.2, 2.0), (-0.4, 2.0)], "yard")
    planner = leaving(terrain, vehicle, KeepOut((), (fence,)), KeepOut())
    path = planner.plan((-1.2, 0.1, 0.0), (1.5, 1.2, 0.0))
    assert path.complete, path.reason
    row = last_broken(path, footprint, KeepOut((), (fence,)))
    driven = np.hypot(*np.diff(path.poses[: row + 1, :2], axis=0).T).sum()
    assert 0.8 < driven < 0.8 + footprint[:, 0].max() + 0.35


def test_a_robot_for_which_there_is_no_way_out_says_so(terrain: Terrain, vehicle: Vehicle) -> None:
    everything = Polygon.of([(-9, -9), (9, -9), (9, 9), (-9, 9)], "all")
    planner = leaving(terrain, vehicle, KeepOut((everything,)), KeepOut())
    path = planner.plan((0.0, 0.0, 0.0), (1.0, 0.0, 0.0))
    assert not path.complete and len(path.poses) == 0
    assert (
        path.reason == "the robot stands in or next to keep-out region 'all', and no path leads out"
    )
    assert not planner.reachable_area((0.0, 0.0, 0.0)).any()


def test_time_of_a_straight_drive_and_of_a_turn_by_hand() -> None:
    """v / a to reach the speed and as long to stop, the rest at full speed; half a second's lag."""
    config = PathFollowingConfig()
    straight = np.array([[0.0, 0.0, 0.0], [2.0, 0.0, 0.0]])
    by_hand = 2.0 / config.max_speed + config.max_speed / config.acceleration
    assert drive_seconds(straight, config) - 0.5 == pytest.approx(by_hand, rel=0.08)
    turn = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 2.0]])
    by_hand = 2.0 / config.max_turn_rate + config.max_turn_rate / config.turn_acceleration
    assert drive_seconds(turn, config) - 0.5 == pytest.approx(by_hand, rel=0.15)
    assert drive_seconds(np.zeros((0, 3)), config) == 0.0
