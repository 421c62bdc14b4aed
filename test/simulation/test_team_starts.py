"""Starts of a team: clear as they say, and the target in sight."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from infomap_ros.simulation.team_world import team_starts
from infomap_ros.simulation.worlds.builder import World
from infomap_ros.simulation.worlds.scenes import make_world

WORLDS = [("cave", 3), ("office", 3), ("mars", 1)]


@cache
def world_of(name: str, seed: int) -> World:
    return make_world(name, seed, size=5.0)


@pytest.mark.parametrize(("name", "seed"), WORLDS)
def test_they_stand_side_by_side_about_the_start_and_see_the_target(name: str, seed: int) -> None:
    world = world_of(name, seed)
    right, left = team_starts(world, 2)
    middle = np.add(right.place[:2], left.place[:2]) / 2.0
    np.testing.assert_allclose(middle, world.start[:2], atol=1e-9)
    aside = np.array([-np.sin(world.start[2]), np.cos(world.start[2])])
    between = np.subtract(left.place[:2], right.place[:2])
    np.testing.assert_allclose(between, 1.0 * aside, atol=1e-9)
    assert world.T_world_target is not None
    for x, y, yaw in (right.place, left.place):
        to_target = world.T_world_target[:2, 3] - (x, y)
        off = np.arctan2(to_target[1], to_target[0]) - yaw
        assert abs(np.angle(np.exp(1j * off))) < 0.26


@pytest.mark.parametrize(("name", "seed"), WORLDS)
def test_nothing_stands_in_what_is_called_clear(
    name: str, seed: int, rng: np.random.Generator
) -> None:
    world = world_of(name, seed)
    for start in team_starts(world, 2):
        assert 0.5 < start.clearance <= 1.5
        radii = start.clearance * np.sqrt(rng.uniform(size=4000))
        angles = rng.uniform(0.0, 2.0 * np.pi, 4000)
        where = np.stack([radii * np.cos(angles), radii * np.sin(angles)], axis=-1)
        where += start.place[:2]
        heights = world.terrain.height(where) + rng.uniform(0.15, 1.2, 4000)
        gaps = world.surface_distance(np.column_stack([where, heights]))
        assert gaps.min() > 0.02


@pytest.mark.parametrize(("name", "seed"), WORLDS)
def test_what_ends_the_clear_space_is_there(name: str, seed: int) -> None:
    world = world_of(name, seed)
    for start in team_starts(world, 2):
        angles = np.linspace(0.0, 2.0 * np.pi, 720)
        rim = (start.clearance + 0.08) * np.stack([np.cos(angles), np.sin(angles)], axis=-1)
        rim += start.place[:2]
        heights = np.arange(0.1, 1.3, 0.02)
        levels = world.terrain.height(rim)[:, None] + heights
        columns = np.broadcast_to(rim[:, None], (*levels.shape, 2))
        points = np.concatenate([columns, levels[..., None]], axis=-1).reshape(-1, 3)
        assert world.surface_distance(points).min() < 0.08


def test_one_robot_starts_where_the_world_says() -> None:
    (alone,) = team_starts(world_of("office", 3), 1)
    assert alone.place == world_of("office", 3).start
