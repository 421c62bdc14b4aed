"""Room, connection and paths in dense windows against slow, obvious answers."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.sparse import lil_matrix
from scipy.sparse.csgraph import dijkstra

from infomap_ros.geometry import Box, PlacedSolid, make_transform
from infomap_ros.mapping import FREE, OCCUPIED, UNCERTAIN, UNKNOWN
from infomap_ros.views.sampling import space_kernels, surroundings
from infomap_ros.views.sampling.surroundings import SurroundingsConfig, horizons, survey
from infomap_ros.views.situation import RegionOfTask, Situation

from .rooms import CAMERA, facing, seen_room, turning

ROOM = (6.0, 4.0, 2.5)
WALL = ((3.0, 0.0, 0.0, 3.2, 4.0, 2.5),)
START = (1.5, 2.0, 1.2)
SIX = [(1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0), (0, 0, 1), (0, 0, -1)]


def ball_is_free(free: np.ndarray, middle: tuple[int, ...], square: float) -> bool:
    """Every voxel center within the ball is free; beyond the array nothing is."""
    reach = int(np.sqrt(square)) + 1
    for offset in np.ndindex(*[2 * reach + 1] * 3):
        step = np.array(offset) - reach
        if step @ step > square:
            continue
        place = np.array(middle) + step
        if (place < 0).any() or (place >= free.shape).any() or not free[tuple(place)]:
            return False
    return True


@pytest.mark.parametrize("square", [0.0, 1.0, 4.0, 6.5])
def test_balls_are_free_exactly_where_all_their_voxels_are(
    rng: np.random.Generator, square: float
) -> None:
    free = rng.random((11, 9, 13)) < 0.97
    reach = int(np.ceil(np.sqrt(square)))
    padded = np.zeros(np.array(free.shape) + 2 * reach, bool)
    padded[tuple(slice(reach, reach + side) for side in free.shape)] = free
    found = np.empty(free.shape, bool)
    space_kernels.free_balls(padded, reach, square, np.empty(padded.shape, np.int32), found)
    expected = [ball_is_free(free, place, square) for place in np.ndindex(free.shape)]
    assert 0 < sum(expected) < free.size
    np.testing.assert_array_equal(found, np.reshape(expected, free.shape))


def test_path_lengths_are_those_of_dijkstra(rng: np.random.Generator) -> None:
    cells = rng.random((7, 6, 5)) < 0.35
    cells[3, 3, 2] = True
    places = np.argwhere(cells)
    edges = lil_matrix((len(places), len(places)))
    for i, place in enumerate(places):
        gaps = np.abs(places - place)
        for j in np.flatnonzero(gaps.max(axis=1) == 1):
            edges[i, j] = np.linalg.norm(places[j] - place)
    start = int(np.flatnonzero((places == (3, 3, 2)).all(axis=1))[0])
    expected = np.full(cells.shape, np.inf)
    expected[tuple(places.T)] = dijkstra(edges.tocsr(), indices=start)
    lengths = np.full(cells.shape, np.inf, np.float32)
    space_kernels.path_lengths(
        cells,
        np.array((3, 3, 2)),
        lengths,
        np.empty(cells.size, np.int64),
        np.zeros(cells.shape, bool),
    )
    assert np.isinf(expected[cells]).any() and (expected[cells] > 3.0).any()
    np.testing.assert_allclose(lengths, expected, rtol=1e-5)


def test_targets_are_the_periphery_and_the_uncertain(rng: np.random.Generator) -> None:
    states = rng.choice([UNKNOWN, FREE, UNCERTAIN, OCCUPIED], (9, 8, 7), p=(0.1, 0.8, 0.05, 0.05))
    states = states.astype(np.uint8)
    counts, sums = np.zeros((3, 3, 3, 2), np.int32), np.zeros((3, 3, 3, 3))
    low, high = np.array((1, 0, 2)), np.array((9, 7, 7))
    space_kernels.count_targets(states, 3, low, high, counts, sums)
    expected, places = np.zeros_like(counts), np.zeros_like(sums)
    for place in np.ndindex(states.shape):
        if not ((np.array(place) >= low) & (np.array(place) < high)).all():
            continue
        cell = tuple(np.array(place) // 3)
        inside = all(0 < p < n - 1 for p, n in zip(place, states.shape, strict=True))
        around = [tuple(np.array(place) + step) for step in SIX] if inside else []
        around = [n for n in around if ((np.array(n) >= low) & (np.array(n) < high)).all()]
        periphery = states[place] == FREE and any(states[n] == UNKNOWN for n in around)
        if states[place] == UNCERTAIN or periphery:
            expected[cell][0] += 1
            places[cell] += place
        expected[cell][1] += states[place] == OCCUPIED
    assert expected[..., 0].sum() > 20
    np.testing.assert_array_equal(counts, expected)
    np.testing.assert_array_equal(sums, places)


@pytest.fixture(scope="module")
def divided() -> Situation:
    """A room with a wall through it, seen from both sides; the camera is on the low side."""
    poses = [*turning(START), *turning((4.6, 2.0, 1.2))]
    return Situation(seen_room(poses, ROOM, WALL), CAMERA, 4.0, poses[0])


def test_space_behind_a_wall_is_free_but_not_reached(divided: Situation) -> None:
    around = survey(divided)
    here, there = np.array([(2.05, 2.05, 1.25)]), np.array([(4.05, 2.05, 1.25)])
    assert around.states_at(here)[0] == around.states_at(there)[0] == FREE
    (place,), (far,) = around.in_box(here)[0], around.in_box(there)[0]
    assert around.has_room[tuple(far)]
    assert around.reached[tuple(place)] and not around.reached[tuple(far)]
    assert np.isinf(around.path_lengths(there)[0])


def test_path_around_an_obstacle_is_longer_than_the_straight_line() -> None:
    screen = ((2.9, 0.9, 0.0, 3.1, 4.0, 2.5),)
    poses = [*turning(START, 8), *turning((4.6, 2.0, 1.2), 8), *turning((3.0, 0.5, 1.2), 8)]
    around = survey(Situation(seen_room(poses, ROOM, screen), CAMERA, 4.0, poses[0]))
    goal = np.array([(4.5, 2.0, 1.2), (2.0, 2.0, 1.2)])
    corner = np.array((3.0, 0.7, 1.2))
    shortest = np.linalg.norm(corner - START) + np.linalg.norm(goal[0] - corner)
    length, direct = around.path_lengths(goal)
    assert 0.9 * shortest < length < 1.25 * shortest
    assert direct == pytest.approx(0.5, abs=0.1)
    back = around.path_lengths_from(goal[0], np.array([START]))[0]
    assert back == pytest.approx(length, abs=0.3)


def test_own_body_is_free_and_only_it(divided: Situation) -> None:
    body = PlacedSolid(Box((0.4, 0.4, 0.4)), make_transform(np.eye(3), (3.1, 2.0, 0.4)))
    changed = Situation(divided.voxel_map, CAMERA, 4.0, divided.T_map_camera, free_body=(body,))
    inside, outside = np.array([(3.1, 2.0, 0.4)]), np.array([(3.1, 2.0, 1.0)])
    assert survey(divided).states_at(inside)[0] != FREE
    assert survey(changed).states_at(inside)[0] == FREE
    np.testing.assert_array_equal(
        survey(changed).states_at(outside), survey(divided).states_at(outside)
    )


def test_camera_in_unknown_space_gets_out_through_the_view_that_it_has() -> None:
    pose = facing(0.0, START)
    around = survey(Situation(seen_room([pose], ROOM), CAMERA, 4.0, pose))
    ahead = np.array([(3.0, 2.0, 1.2), (0.8, 2.0, 1.2)])
    places, _ = around.in_box(ahead)
    assert around.reached[tuple(places[0])]
    assert not around.reached[tuple(places[1])]


def test_empty_map_has_no_room_but_where_the_camera_is() -> None:
    pose = facing(0.0, START)
    around = survey(Situation(seen_room([], ROOM), CAMERA, 4.0, pose))
    places = around.centers(np.flatnonzero(around.reached))
    assert 1 <= len(places) <= 33
    assert np.linalg.norm(places - START, axis=1).max() < 0.3


def test_window_does_not_grow_with_the_map_beyond_the_horizon(divided: Situation) -> None:
    near = survey(divided, SurroundingsConfig(horizon=0.5))
    limits = np.array(near.reached.shape) * near.voxel_size
    assert (limits < 2 * 0.5 + 0.25).all()
    assert not near.is_whole and survey(divided).is_whole


def test_horizon_widens_as_far_as_is_affordable(
    divided: Situation, monkeypatch: pytest.MonkeyPatch
) -> None:
    wide = list(horizons(divided, SurroundingsConfig(horizon=0.5)))
    assert [settings.horizon for settings in wide] == [0.5, 1.0, 2.0]
    monkeypatch.setattr(surroundings, "_LARGEST_WINDOW", 1000)
    narrow = list(horizons(divided, SurroundingsConfig(horizon=0.5)))
    assert [settings.horizon for settings in narrow] == [0.5]


def test_things_outside_the_region_are_no_targets(divided: Situation) -> None:
    region = RegionOfTask((0.0, 0.0, 0.0), (2.0, 4.0, 2.5))
    limited = Situation(divided.voxel_map, CAMERA, 4.0, divided.T_map_camera, region=region)
    assert (survey(divided).targets.places[:, 0] > 2.2).any()
    assert (survey(limited).targets.places[:, 0] < 2.2).all()
