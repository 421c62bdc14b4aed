"""Dense windows of the map against the map's own point queries."""

from __future__ import annotations

import numpy as np
import pytest

from infomap_ros.errors import ConfigError, InvalidInputError
from infomap_ros.geometry import PinholeCamera, make_transform
from infomap_ros.mapping import (
    FREE,
    LOG_ODDS_QUANTUM,
    OCCUPIED,
    UNCERTAIN,
    UNKNOWN,
    OccupancyThresholds,
    VoxelMap,
    VoxelMapConfig,
)
from infomap_ros.mapping.voxels.window import UNKNOWN_QUANTA


@pytest.fixture(scope="module")
def wall() -> VoxelMap:
    """A tilted wall seen twice from places with odd coordinates."""
    camera = PinholeCamera(width=64, height=48, fx=40.0, fy=40.0, cx=31.5, cy=23.5)
    u, v = np.meshgrid(np.arange(64), np.arange(48))
    rays = np.stack([(u - 31.5) / 40.0, (v - 23.5) / 40.0, np.ones(u.shape)], axis=-1)
    points = (rays * (2.0 / (1.0 + 0.2 * rays[..., :1]))).astype(np.float32)
    voxel_map = VoxelMap(VoxelMapConfig(voxel_size=0.07))
    for x in (-0.33, 0.21):
        voxel_map.integrate(points, make_transform(np.eye(3), (x, 0.1, -1.0)), camera=camera)
    return voxel_map


def test_every_voxel_is_that_of_the_map(wall: VoxelMap) -> None:
    window = wall.window((-1.234, -0.9, -1.3), (1.51, 1.0, 1.47))
    positions = np.argwhere(np.ones(window.quanta.shape, bool))
    centers = window.centers_of(positions)
    known = wall.is_known(centers)
    assert known.any() and not known.all()
    quanta = window.quanta[tuple(positions.T)]
    np.testing.assert_array_equal(quanta != UNKNOWN_QUANTA, known)
    np.testing.assert_allclose(
        quanta[known] * LOG_ODDS_QUANTUM, wall.log_odds(centers)[known], rtol=0
    )


def test_window_holds_the_box_and_nothing_more_than_a_voxel_around(wall: VoxelMap) -> None:
    low, high = np.array((-0.5, -0.21, 0.0)), np.array((0.5, 0.7, 0.63))
    window = wall.window(low, high)
    first = window.centers_of([(0, 0, 0)])[0] - 0.035
    last = window.centers_of([np.array(window.quanta.shape) - 1])[0] + 0.035
    assert (first <= low + 1e-9).all() and (first > low - 0.07).all()
    assert (last >= high - 1e-9).all() and (last < high + 0.07).all()


def test_positions_and_centers_are_inverse(wall: VoxelMap) -> None:
    window = wall.window((-1, -1, -1), (1, 1, 1))
    positions = np.array([(0, 0, 0), (3, 4, 5), (-2, 40, 1)])
    np.testing.assert_array_equal(window.positions_of(window.centers_of(positions)), positions)
    np.testing.assert_array_equal(window.contains(positions), [True, True, False])


def test_states_follow_the_probabilities(wall: VoxelMap) -> None:
    window = wall.window((-1.2, -0.9, -1.3), (1.5, 1.0, 1.4))
    states = window.states(OccupancyThresholds(0.05, 0.6, surface_margin=0))
    positions = np.argwhere(np.ones(states.shape, bool))
    centers = window.centers_of(positions)
    known, probability = wall.is_known(centers), wall.probability(centers)
    expected = np.select(
        [~known, probability < 0.05, probability > 0.6], [UNKNOWN, FREE, OCCUPIED], UNCERTAIN
    )
    around = np.argwhere(np.ones((3, 3, 3), bool)) - 1
    for row in np.flatnonzero(states[tuple(positions.T)] != expected):  # holes in what is free
        places = positions[row] + around
        places = places[window.contains(places)]
        near = expected.reshape(states.shape)[tuple(places.T)]
        assert expected[row] != FREE and (near == FREE).sum() >= 13
        assert wall.probability(window.centers_of(places)).max() < 0.95
        expected[row] = FREE
    np.testing.assert_array_equal(states[tuple(positions.T)], expected)
    assert set(np.unique(states)) == {UNKNOWN, FREE, UNCERTAIN, OCCUPIED}


def test_margin_before_a_surface_counts_as_free(wall: VoxelMap) -> None:
    window = wall.window((-1.2, -0.9, -1.3), (1.5, 1.0, 1.4))
    plain = window.states(OccupancyThresholds(surface_margin=0))
    closed = window.states(OccupancyThresholds(surface_margin=2))
    changed = np.argwhere(plain != closed)
    assert len(changed)
    for position in np.argwhere(plain == UNKNOWN)[::17]:
        low, high = np.maximum(position - 2, 0), position + 3
        around = plain[low[0] : high[0], low[1] : high[1], low[2] : high[2]]
        between = (around == OCCUPIED).any() and (around == FREE).any()
        assert (closed[tuple(position)] == FREE) == between
    known = plain != UNKNOWN
    np.testing.assert_array_equal(plain[known], closed[known])


@pytest.mark.parametrize(
    ("low", "high", "message"),
    [
        ((0, 0, 0), (1, -1, 1), "not a box"),
        ((0, 0, np.nan), (1, 1, 1), "not a box"),
        ((0, 0, 0), (1e9, 1, 1), "limits"),
        ((0, 0, 0), (5e3, 5e3, 5e3), "too large"),
    ],
)
def test_impossible_windows_are_refused(
    wall: VoxelMap, low: object, high: object, message: str
) -> None:
    with pytest.raises(InvalidInputError, match=message):
        wall.window(low, high)


def test_thresholds_must_not_cross() -> None:
    with pytest.raises(ConfigError, match="free_probability"):
        OccupancyThresholds(0.4, 0.3)
