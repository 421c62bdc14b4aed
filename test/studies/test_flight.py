"""A flying camera: paths through known free space, against Dijkstra and by hand."""

from __future__ import annotations

import heapq
import itertools

import numpy as np
import pytest

from infomap_ros.mapping import OccupancyThresholds, VoxelMap, VoxelMapConfig
from infomap_ros.mapping.voxels.state import put_states, unknown_states
from infomap_ros.studies.flight import NO_PATH, FreeFlight
from test.views.rooms import facing

SIZE = 0.5
STRICT = OccupancyThresholds(surface_margin=0)


def map_of(free: np.ndarray, occupied: np.ndarray) -> VoxelMap:
    """A map of one layer from two grids, shape (nx, ny) each; the rest is unknown."""
    voxel_map = VoxelMap(VoxelMapConfig(voxel_size=SIZE))
    for cells, quanta in ((free, -20), (occupied, 20)):
        places = np.argwhere(cells)
        states = unknown_states(np.column_stack([places, np.zeros(len(places))]).astype(np.int32))
        states.known[:] = True
        states.quanta[:] = quanta
        put_states(voxel_map._storage, states)
    return voxel_map


def center(i: int, j: int) -> tuple[float, float, float]:
    return ((i + 0.5) * SIZE, (j + 0.5) * SIZE, 0.5 * SIZE)


def shortest(free: np.ndarray, start: tuple[int, int]) -> np.ndarray:
    """Lengths over the 8 neighbors, [m]."""
    lengths = np.full(free.shape, np.inf)
    lengths[start] = 0.0
    queue = [(0.0, start)]
    while queue:
        length, (i, j) = heapq.heappop(queue)
        for a in range(max(0, i - 1), min(free.shape[0], i + 2)):
            for b in range(max(0, j - 1), min(free.shape[1], j + 2)):
                longer = length + SIZE * float(np.hypot(a - i, b - j))
                if free[a, b] and longer < lengths[a, b] - 1e-9:
                    lengths[a, b] = longer
                    heapq.heappush(queue, (longer, (a, b)))
    return lengths


def test_path_round_a_wall_is_pulled_straight() -> None:
    free = np.ones((21, 21), np.bool_)
    wall = np.zeros_like(free)
    wall[10, :16] = True
    flight = FreeFlight(map_of(free & ~wall, wall), facing(0.0, center(5, 5)), (0.1, 0.4), STRICT)
    found = flight.reach(facing(0.0, center(15, 5)))
    corners = found.route
    assert isinstance(corners, np.ndarray)
    np.testing.assert_allclose(corners[[0, -1]], [center(5, 5), center(15, 5)])
    steps = np.linalg.norm(np.diff(corners, axis=0), axis=1)
    assert found.travel == pytest.approx(steps.sum())
    above = [np.hypot(5.5, 10.5) * SIZE] * 2  # round the end of the wall, at its nearest
    assert sum(above) - SIZE < found.travel < sum(above) + 2 * SIZE


def test_paths_lie_in_free_space_and_are_no_longer_than_over_neighbors(rng) -> None:
    occupied = rng.random((30, 30)) < 0.2
    occupied[3, 4] = False
    free = ~occupied
    flight = FreeFlight(map_of(free, occupied), facing(0.0, center(3, 4)), (0.1, 0.4), STRICT)
    lengths = shortest(free, (3, 4))
    reached = 0
    for i, j in rng.integers(0, 30, (60, 2)):
        found = flight.reach(facing(0.0, center(int(i), int(j))))
        if not np.isfinite(lengths[i, j]) or not free[i, j]:
            assert found.reason == NO_PATH
            continue
        reached += 1
        straight = np.hypot(i - 3, j - 4) * SIZE
        assert straight - 1e-6 <= found.travel <= lengths[i, j] + 1e-4
        corners = np.asarray(found.route)
        for a, b in itertools.pairwise(corners):
            on_path = a + np.linspace(0.0, 1.0, 400)[:, None] * (b - a)
            cells = np.floor(on_path[:, :2] / SIZE).astype(int)
            assert free[tuple(cells.T)].mean() > 0.95  # corners may be grazed
    assert reached > 20


def test_unknown_and_uncertain_space_is_not_flown_through() -> None:
    free = np.ones((15, 5), np.bool_)
    free[7] = False  # unknown
    flight = FreeFlight(map_of(free, ~np.ones_like(free)), facing(0.0, center(2, 2)), (0.1, 0.4))
    assert flight.reach(facing(0.0, center(12, 2))).reason == NO_PATH
    assert flight.reach(facing(0.0, center(7, 2))).reason == NO_PATH
    assert flight.reach(facing(1.0, center(2, 2))).travel == 0.0
    assert flight.may_reach(np.eye(4)[None]) == [""]
