"""The baselines' parts against brute force, and what each is meant to prefer."""

from __future__ import annotations

from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest

from infomap_ros.studies.baselines.frontiers import (
    NearestFrontier,
    find_frontiers,
    frontier_cells,
    level_views,
    shares_of,
)
from infomap_ros.studies.baselines.view_tree import grow_tree
from infomap_ros.studies.planar.explore import ExplorationConfig, PlanarExplorer, planar_choice
from infomap_ros.studies.planar.world import make_world
from infomap_ros.views.ranking.options import Options
from infomap_ros.views.ranking.rating import Ratings
from infomap_ros.views.sampling.surroundings import Surroundings, survey
from infomap_ros.views.situation import Situation

CELL, RANGE = 1.0, 15.0


@pytest.fixture(scope="module")
def seen() -> tuple[PlanarExplorer, Situation, Surroundings]:
    """A cave after four scans."""
    explorer = PlanarExplorer(make_world("caves", 2, CELL), ExplorationConfig(seed=3), "random")
    for _ in range(4):
        explorer.look()
        situation = explorer.situation(explorer.map)
        explorer.move(situation)
    surroundings = survey(situation, planar_choice(RANGE, CELL).surroundings)
    return explorer, situation, surroundings


def states_by_cell(situation: Situation, side: int) -> np.ndarray:
    """0 unknown, 1 free, 2 occupied, by the map's own queries."""
    centers = np.argwhere(np.ones((side, side), np.bool_)) + 0.5
    places = np.column_stack([centers, np.full(len(centers), 0.5)]) * CELL
    known, p = situation.voxel_map.is_known(places), situation.voxel_map.probability(places)
    return np.where(known, np.where(p < 0.5, 1, 2), 0).reshape(side, side)


def test_frontiers_are_free_cells_beside_unknown_ones(seen) -> None:
    explorer, situation, surroundings = seen
    side = explorer.world.occupied.shape[0]
    states = states_by_cell(situation, side)
    reached, stack = set(), [tuple(np.floor(situation.position[:2] / CELL).astype(int))]
    while stack:
        i, j = stack.pop()
        if (i, j) not in reached and states[i, j] == 1:
            reached.add((i, j))
            stack += [(i + 1, j), (i - 1, j), (i, j + 1), (i, j - 1)]
    expected = {
        (i, j)
        for i, j in reached
        if 0 in (states[i + 1, j], states[i - 1, j], states[i, j + 1], states[i, j - 1])
    }
    first = surroundings.window.first[:2]
    cells = np.argwhere(frontier_cells(situation, surroundings)) + first
    assert {(int(i), int(j)) for i, j in cells} == expected
    assert len(expected) > 20


def test_groups_hold_every_frontier_cell_once_and_are_small_enough(seen) -> None:
    _, situation, surroundings = seen
    cells = np.count_nonzero(frontier_cells(situation, surroundings))
    groups = find_frontiers(situation, surroundings, least=1, largest=4.0)
    places = np.concatenate([group.places for group in groups])
    assert len(places) == cells == len(np.unique(places, axis=0))
    for group in groups:
        assert np.linalg.norm(group.places - group.middle, axis=1).max() <= 4.0
        assert (group.places == group.center).all(axis=1).any()


def test_trees_grow_through_free_space(seen, rng: np.random.Generator) -> None:
    _, situation, surroundings = seen
    tree = grow_tree(situation, surroundings, rng, nodes=40, edge=5.0)
    assert len(tree.places) == 40
    for node in range(1, 40):
        start, end = tree.places[tree.parents[node]], tree.places[node]
        length = np.linalg.norm(end - start)
        assert length <= 5.0 + CELL
        assert tree.lengths[node] == pytest.approx(tree.lengths[tree.parents[node]] + length)
        on_edge = start + np.linspace(0.0, 1.0, 40)[:, None] * (end - start)
        assert (situation.voxel_map.probability(on_edge) < 0.05).mean() > 0.9
        assert tree.branch(node)[-1] == node


def test_nearest_frontier_goes_to_the_nearest(seen) -> None:
    explorer, situation, surroundings = seen
    strategy = NearestFrontier()
    other = PlanarExplorer(explorer.world, ExplorationConfig(), strategy)
    other.pose, other.past = situation.T_map_camera, list(explorer.past)
    other.move(situation)
    centers = [group.center for group in find_frontiers(situation, surroundings)]
    distances = surroundings.path_lengths(np.array(centers))
    gone = np.linalg.norm(np.array(centers) - other.pose[:3, 3], axis=1)
    assert gone.min() < 1e-6
    assert (
        distances[gone.argmin()] <= np.sort(distances)[min(1, len(distances) - 1)]
    )  # the nearest of use


def test_views_that_were_taken_tell_nothing_more() -> None:
    """Whatever the rays promise: they leak past corners of obstacles that a scan does not."""
    azimuths, places = np.array([0.0, 0.02, 0.3, 0.0]), np.zeros((4, 3))
    places[3] = (2.0, 0.0, 0.0)
    poses = level_views(places, azimuths)
    size = SimpleNamespace(voxel_size=CELL)
    past = SimpleNamespace(past_views=poses[:1])
    options = cast("Options", SimpleNamespace(poses=poses, situation=past, surroundings=size))
    ratings = cast("Ratings", SimpleNamespace(shares=np.array([0.1, 0.2, 0.3, 0.4])))
    shares = shares_of(options, ratings, np.array([3, 2, 1, 0, -1]))
    np.testing.assert_array_equal(shares, [0.4, 0.3, 0.0, 0.0, 0.0])
