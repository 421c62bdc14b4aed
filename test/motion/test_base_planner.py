"""Paths of the base against an exhaustive search in plain Python."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest

from infomap_ros.errors import ConfigError, InvalidInputError
from infomap_ros.motion.base import base_planner
from infomap_ros.motion.base.base_planner import BasePlanner
from infomap_ros.motion.base.drive_graph import arc_points
from infomap_ros.motion.base.drive_space import TURN_STEP, BasePath, BasePlannerConfig
from infomap_ros.motion.base.stance import STANDS, tilt_to
from infomap_ros.motion.base.standing_ground import with_standing_ground
from infomap_ros.motion.base.vehicle import Vehicle

from .drive_oracle import DriveOracle
from .grounds import CELL, ground, plane, rover, stance_of

HALF = 1.8


@pytest.fixture(scope="module")
def vehicle() -> Vehicle:
    return rover()


def cluttered(seed: int, posts: int = 14):
    """Level ground with posts, the middle free."""
    rng = np.random.default_rng(seed)
    places = rng.uniform(-HALF, HALF, (posts, 2))
    places = places[np.hypot(*places.T) > 0.55]

    def height(x, y):
        z = 0.05 * x
        for a, b in places:
            z = np.where(np.hypot(x - a, y - b) < 0.08, z + 0.6, z)
        return z

    return ground(height, HALF)


def is_drivable(path: BasePath, planner: BasePlanner) -> None:
    """Every pose is good, none is far from the one before, and none is sideways of it."""
    batch = planner.vehicle.stances(planner.terrain, path.poses)
    assert (batch.outcomes == STANDS).all()
    np.testing.assert_allclose(batch.T_map_base, path.T_map_base)
    step, turn = np.diff(path.poses[:, :2], axis=0), np.diff(path.poses[:, 2])
    length = np.hypot(*step.T)
    assert length.max(initial=0.0) <= CELL + 1e-9
    assert np.abs(turn).max(initial=0.0) <= TURN_STEP + 1e-9
    moving = length > 1e-6
    assert (np.abs(turn[moving]) < 1e-6).all()
    heading = path.poses[:-1, 2][moving]
    sideways = step[moving, 0] * np.sin(heading) - step[moving, 1] * np.cos(heading)
    assert np.abs(sideways).max(initial=0.0) < 1e-6
    assert path.length == pytest.approx(length.sum())


@pytest.fixture(scope="module", params=[1, 2, 5])
def searched(request, vehicle):
    """A cluttered place, and what the exhaustive search says of it."""
    terrain = cluttered(request.param)
    oracle = DriveOracle(terrain, vehicle, BasePlannerConfig().turn_cost)
    middle = tuple(int(n) for n in terrain.cells_of((CELL / 2, CELL / 2)))
    return terrain, oracle, (*middle, 0)


def test_reached_cells_are_those_of_the_exhaustive_search(searched, vehicle):
    terrain, oracle, node = searched
    costs = oracle.costs_from(node)
    planner = BasePlanner(terrain, vehicle)
    reached = planner.reachable_area(oracle.place_of(node))
    np.testing.assert_array_equal(reached, np.isfinite(costs).any(axis=2))
    assert 0.05 < reached.mean() < 0.8


@pytest.mark.parametrize("samples", [0, 2000])
def test_every_query_that_has_a_solution_is_solved(searched, vehicle, rng, samples):
    """With OMPL and without; those without one end as near to the goal as can be."""
    terrain, oracle, node = searched
    costs, start = oracle.costs_from(node), oracle.place_of(node)
    reached = np.argwhere(np.isfinite(costs).any(axis=2))
    standable = np.argwhere(oracle.nodes)
    planner = BasePlanner(terrain, vehicle)
    outcomes = []
    for goal in standable[rng.integers(0, len(standable), 12)]:
        target = oracle.place_of(tuple(goal))
        path = planner.plan(start, target, samples)
        is_drivable(path, planner)
        np.testing.assert_allclose(path.poses[0], start, atol=1e-9)
        outcomes.append(path.complete)
        if np.isfinite(costs[tuple(goal)]):
            assert path.complete, path.reason
        if path.complete:
            assert path.reason == ""
            np.testing.assert_allclose(path.poses[-1, :2], target[:2], atol=1e-9)
            assert math.cos(path.poses[-1, 2] - target[2]) == pytest.approx(1.0)
            continue
        nearest = np.hypot(*(terrain.centers_of(reached) - target[:2]).T).min()
        assert np.hypot(*(path.poses[-1, :2] - target[:2])) == pytest.approx(nearest, abs=1e-6)
        assert f"ends {nearest:.2f} m from it" in path.reason
    assert any(outcomes)


def test_ompl_makes_the_zigzag_of_the_lattice_straight(vehicle):
    """In an open field the shortest path is known: turn, drive straight, turn."""
    planner = BasePlanner(ground(plane(0.05, 0.0), HALF + 0.6), vehicle)
    start, goal = np.array([-1.4, -1.0, 0.3]), np.array([1.37, 0.21, 0.0])
    zigzag, path = planner.plan(start, goal, 0), planner.plan(start, goal)
    assert (zigzag.method, path.method) == ("lattice", "ompl")
    is_drivable(path, planner)
    assert path.length < zigzag.length - 0.02
    assert path.turning < zigzag.turning
    straight = math.dist(start[:2], goal[:2])
    assert path.length == pytest.approx(straight, rel=0.01)


def test_paths_of_ompl_cost_no_more_and_stay_valid(searched, vehicle, rng):
    """Among posts: never dearer than the lattice's, and `Vehicle` accepts each stance."""
    terrain, oracle, node = searched
    reached = np.argwhere(np.isfinite(oracle.costs_from(node)))
    planner = BasePlanner(terrain, vehicle)
    start, turn_cost, methods = oracle.place_of(node), planner.config.turn_cost, set()
    for goal in reached[rng.integers(0, len(reached), 8)]:
        target = oracle.place_of(tuple(goal))
        before, path = planner.plan(start, target, 0), planner.plan(start, target)
        is_drivable(path, planner)
        cost = path.length + turn_cost * path.turning
        assert cost <= before.length + turn_cost * before.turning + 1e-6
        assert (path.method == "lattice") == np.array_equal(path.poses, before.poses)
        np.testing.assert_allclose(path.poses[[0, -1], :2], before.poses[[0, -1], :2], atol=1e-9)
        methods.add(path.method)
    assert "ompl" in methods


def test_the_same_question_has_the_same_answer(vehicle):
    """Whatever was planned in between, in this planner or another."""
    start, goal = (0.9, 0.0, 0.0), (-0.9, 1.3, 0.0)
    planner = BasePlanner(walled(0.8), vehicle)
    first = planner.plan(start, goal)
    assert first.method == "ompl"
    planner.plan(start, (-1.2, -0.7, 2.0))
    again, elsewhere = planner.plan(start, goal), BasePlanner(walled(0.8), vehicle)
    np.testing.assert_array_equal(again.poses, first.poses)
    np.testing.assert_array_equal(elsewhere.plan(start, goal).poses, first.poses)


def test_where_ompl_finds_nothing_better_the_path_of_the_lattice_is_driven(vehicle):
    """A straight drive through a narrow gap cannot be made shorter."""
    planner = BasePlanner(walled(0.8), vehicle)
    path = planner.plan((0.025, 0.025, math.pi / 2), (0.025, 1.325, math.pi / 2))
    assert path.complete
    assert path.method == "lattice"
    assert path.length == pytest.approx(1.3)


def test_costs_of_the_search_are_the_smallest(searched, vehicle):
    """Dial's buckets count in twentieths of a cell: each move is rounded to one."""
    terrain, oracle, node = searched
    costs = oracle.costs_from(node)
    planner = BasePlanner(terrain, vehicle)
    planner.reachable_area(oracle.place_of(node))
    found = planner._reach._graph.costs * CELL / 20.0
    both = np.isfinite(costs)
    np.testing.assert_array_equal(planner._reach._graph.costs >= 0, both)
    np.testing.assert_allclose(found[both], costs[both], rtol=0.05, atol=0.02)


def walled(gap: float | None):
    """Level ground that a wall along y = 0.9 divides, with a gap at x = 0."""

    def height(x, y):
        wall = np.abs(y - 0.9) < 0.08
        if gap is not None:
            wall &= np.abs(x) > 0.5 * gap
        return np.where(wall, 1.0, 0.0)

    return ground(height, HALF)


def test_passage_is_found_and_a_closed_wall_gives_the_farthest_approach(vehicle):
    through = BasePlanner(walled(0.8), vehicle).plan((0, 0, 0), (0.0, 1.3, 0.0))
    assert through.complete
    stopped = BasePlanner(walled(None), vehicle).plan((0, 0, 0), (0.0, 1.3, 0.0))
    assert not stopped.complete
    assert stopped.reason.startswith("no path to the goal over ground that is known and safe")
    assert 0.3 < stopped.poses[-1, 1] < 0.8


def test_nearest_of_several_goals_is_named(vehicle):
    goals = [(0.0, 1.3, 0.0), (-1.2, -1.2, 1.0)]
    path = BasePlanner(walled(None), vehicle).plan((0, 0, 0), goals)
    assert path.complete and path.goal == 1


def test_goal_of_any_heading_is_reached_without_a_last_turn(vehicle):
    path = BasePlanner(ground(plane(0, 0)), vehicle).plan((0, 0, 0), (1.0, 1.0, math.nan))
    assert path.complete
    np.testing.assert_allclose(path.poses[-1, :2], (1.0, 1.0), atol=1e-9)
    assert path.turning == pytest.approx(math.pi / 4, abs=1e-6)
    assert path.length == pytest.approx(math.sqrt(2.0))


def test_goal_that_cannot_be_stood_on_says_why(vehicle):
    path = BasePlanner(walled(0.8), vehicle).plan((0, 0, 0), (1.0, 0.9, 0.0))
    assert not path.complete
    assert path.reason.startswith("goal: ")


def test_without_reverse_it_only_drives_forwards(vehicle):
    config = BasePlannerConfig(reverse=False)
    planner = BasePlanner(cluttered(1), vehicle, config)
    for goal in ((-1.2, 0.0, 0.0), (0.0, -1.2, 1.0)):
        for samples in (0, 2000):
            path = planner.plan((0.0, 0.0, 0.0), goal, samples)
            step, yaw = np.diff(path.poses[:, :2], axis=0), path.poses[:-1, 2]
            assert (step[:, 0] * np.cos(yaw) + step[:, 1] * np.sin(yaw)).min() > -1e-9
            is_drivable(path, planner)


def test_start_on_ground_that_was_never_seen_does_not_lock(vehicle):
    """Nothing is known under the robot and 5 cm around it."""

    def height(x, y):
        return np.where((np.abs(x) < 0.28) & (np.abs(y) < 0.26), np.nan, 0.1 * x)

    terrain = ground(height, near=(0.0, 0.0, 0.0762))
    assert not stance_of(vehicle, terrain, 0.0, 0.0, 0.0).ok
    here = np.eye(4)
    tilt_to(here, 0.0, 0.1, 0.0)
    here[2, 3] = 0.0762 * np.hypot(1.0, 0.1)
    planner = BasePlanner(terrain, vehicle, standing=here)
    path = planner.plan((0.0, 0.0, 0.0), (1.2, 0.3, 0.0))
    assert path.complete
    np.testing.assert_allclose(path.T_map_base[0][:3, 2] @ (0.1, 0.0, -1.0), -1.005, atol=2e-3)
    is_drivable(path, planner)


def test_robot_that_stands_where_it_should_not_may_leave(vehicle, monkeypatch):
    """A post has come to stand next to the wheel."""

    def height(x, y):
        return np.where(np.hypot(x - 0.16, y - 0.24) < 0.03, 0.5, 0.0)

    terrain = ground(height)
    assert not stance_of(vehicle, terrain, 0.0, 0.0, 0.0).ok
    path = BasePlanner(terrain, vehicle).plan((0, 0, 0), (-1, 0, 0))
    assert path.complete
    monkeypatch.setattr(base_planner, "_ESCAPE", 0.0)
    locked = BasePlanner(terrain, vehicle).plan((0, 0, 0), (-1, 0, 0))
    assert not locked.complete and len(locked.poses) == 0
    assert locked.reason.startswith("the robot cannot leave its place: ")


@pytest.mark.parametrize(("gap", "leaves"), [(-0.03, True), (0.1, True)])
def test_robot_leaves_ground_of_which_only_occupied_voxels_are_known(vehicle, gap, leaves):
    """Where it stands is ground, whatever the map shows there."""
    terrain = ground(lambda x, y: np.zeros_like(x))
    under = np.hypot(*(terrain.centers_of(np.argwhere(terrain.heights == 0.0))).T) < 0.3
    i, j = np.argwhere(terrain.heights == 0.0)[under].T
    heights, overhead = terrain.heights.copy(), terrain.overhead.copy()
    heights[i, j], overhead[i, j] = np.nan, gap
    doubtful = dataclasses.replace(terrain, heights=heights, overhead=overhead)
    standing = np.eye(4)
    standing[2, 3] = 0.0762

    path = BasePlanner(doubtful, vehicle, standing=standing).plan((0, 0, 0), (-1, 0, 0))

    assert path.complete is leaves


@pytest.mark.parametrize("place", [(0.16, 0.16), (0.18, 0.0), (-0.2, -0.2)])
def test_false_ground_under_the_robot_makes_no_step_beside_it(vehicle, place):
    terrain = ground(lambda x, y: 0.25 * (np.hypot(x - place[0], y - place[1]) < 0.04))
    standing = np.eye(4)
    standing[2, 3] = 0.0762
    assert not stance_of(vehicle, terrain, 0.0, 0.0, 0.0).ok
    known = with_standing_ground(terrain, vehicle, standing)
    np.testing.assert_allclose(known.step, 0.0, atol=1e-6)
    moved = [(x, y, yaw) for x in (-0.1, 0.0, 0.1) for y in (-0.1, 0.1) for yaw in (0.0, 0.5)]
    assert vehicle.stances(known, np.array(moved)).ok.all()


def test_edge_beside_where_the_robot_stands_stays_a_step(vehicle):
    """Its own ground was never seen; beside it, the ground lies half a meter lower."""

    def height(x, y):
        return np.where(
            x < 0.35, np.where((np.abs(x) < 0.3) & (np.abs(y) < 0.3), np.nan, 0.0), -0.5
        )

    standing = np.eye(4)
    standing[2, 3] = 0.0762
    known = with_standing_ground(ground(height), vehicle, standing)
    assert known.step[tuple(known.cells_of((0.375, 0.0)))] > 0.3


def test_ground_declared_at_the_edge_of_the_map_has_no_step(vehicle):
    nothing = ground(lambda x, y: np.full_like(x, np.nan))
    standing = np.eye(4)
    standing[:3, 3] = -1.9, 1.9, 0.0762
    known = with_standing_ground(nothing, vehicle, standing)
    at_edge = known.step[0][np.isfinite(known.heights[0])]
    assert len(at_edge) and (at_edge == 0.0).all()


def test_reachable_area_ends_at_a_wall(vehicle):
    planner = BasePlanner(walled(None), vehicle)
    area = planner.reachable_area((0.0, 0.0, 0.0))
    assert not area[:, planner.terrain.cells_of((0.0, 1.2))[1] :].any()


@pytest.mark.parametrize(("radius", "reverse"), [(0.4, True), (0.4, False), (1.0, True)])
def test_vehicle_that_cannot_turn_in_place_drives_on_curves(vehicle, rng, radius, reverse):
    """No turn on the spot, none tighter than the radius, never sideways."""
    config = BasePlannerConfig(turning_radius=radius, reverse=reverse, turn_cost=0.1)
    planner = BasePlanner(cluttered(2, 5), vehicle, config)
    solved = 0
    for x, y, yaw in rng.uniform((-1.2, -1.2, -3), (1.2, 1.2, 3), (12, 3)):
        path = planner.plan((0.0, 0.0, 0.5), (x, y, yaw))
        solved += path.complete
        assert vehicle.stances(planner.terrain, path.poses).ok.all()
        step, turn = np.diff(path.poses[:, :2], axis=0), np.diff(path.poses[:, 2])
        length = np.hypot(*step.T)
        assert length.max(initial=0.0) < 1.5 * CELL
        # A chord is a little shorter than its arc, and much where forwards meets backwards, which
        # it does at most twice in a curve at each end.
        assert np.abs(turn).max(initial=0.0) <= 1.02 * CELL / radius
        tight = np.abs(turn) > 1.02 * length / radius + 1e-6
        assert tight.sum() <= (4 if reverse else 0)
        half = path.poses[:-1, 2] + 0.5 * turn
        ahead = step[:, 0] * np.cos(half) + step[:, 1] * np.sin(half)
        aside = step[:, 1] * np.cos(half) - step[:, 0] * np.sin(half)
        assert np.abs(aside).max(initial=0.0) < 0.012
        assert reverse or ahead.min(initial=0.0) > -1e-9
        if path.complete:
            np.testing.assert_allclose(path.poses[-1, :2], (x, y), atol=1e-6)
    assert solved >= 4


def test_arc_links_two_headings(rng):
    """End points, the given radius, and equal steps, forwards and backwards."""
    for _ in range(200):
        a = rng.uniform((-2, -2, -3), (2, 2, 3))
        turn, sign = rng.uniform(0.2, 2.0) * rng.choice([-1, 1]), rng.choice([-1, 1])
        before, after = rng.uniform(0.2, 2.0, 2)
        first = np.array([math.cos(a[2]), math.sin(a[2])])
        last = np.array([math.cos(a[2] + turn), math.sin(a[2] + turn)])
        b = np.append(a[:2] + sign * (before * first + after * last), a[2] + turn)
        points = arc_points(a, b, 0.01)
        np.testing.assert_allclose(points[0], a, atol=1e-9)
        np.testing.assert_allclose(points[-1], b, atol=1e-9)
        step, turns = np.diff(points[:, :2], axis=0), np.abs(np.diff(points[:, 2]))
        radius = min(before, after) / math.tan(0.5 * abs(turn))
        assert turns.max() <= 0.01 / radius + 1e-9
        assert np.hypot(*step.T).max() <= 0.01 + 1e-9
        half = points[:-1, 2] + 0.5 * np.diff(points[:, 2])
        ahead = sign * (step[:, 0] * np.cos(half) + step[:, 1] * np.sin(half))
        assert (ahead > 0.99 * np.hypot(*step.T) - 1e-9).all()


def test_nonsense_is_refused_by_name(vehicle):
    planner = BasePlanner(ground(plane(0, 0)), vehicle)
    with pytest.raises(InvalidInputError, match="start"):
        planner.plan((0.0, 0.0, math.nan), (1.0, 0.0, 0.0))
    with pytest.raises(InvalidInputError, match="goals"):
        planner.plan((0.0, 0.0, 0.0), (1.0, math.inf, 0.0))
    with pytest.raises(InvalidInputError, match="goals"):
        planner.plan((0.0, 0.0, 0.0), (1.0, 0.0))
    with pytest.raises(ConfigError, match="turning_radius"):
        BasePlannerConfig(turning_radius=-1.0)
