"""CoarseViews through windows of voxels whose content is known."""

from __future__ import annotations

import numpy as np
import pytest

from infomap_ros.mapping import FREE, OCCUPIED, UNKNOWN
from infomap_ros.views.sampling import coarse_views


def walled() -> np.ndarray:
    """Free space with a wall at x = 12 that leaves y >= 15 open."""
    states = np.full((20, 20, 20), FREE, np.uint8)
    states[12, :15] = OCCUPIED
    return states


def seen_by_sampling(states: np.ndarray, origin: np.ndarray, target: np.ndarray) -> bool:
    """Ten samples per voxel up to two voxels before the target."""
    length = np.linalg.norm(target - origin)
    for along in np.arange(0.0, length - 2.0, 0.1):
        place = np.floor(origin + (target - origin) * along / length).astype(int)
        if states[tuple(place)] == OCCUPIED:
            return False
    return True


def test_targets_behind_a_wall_are_not_in_sight(rng: np.random.Generator) -> None:
    states, origin = walled(), np.array((5.2, 6.1, 9.7))
    targets = rng.uniform(1.0, 19.0, (200, 3))
    seen = np.array([seen_by_sampling(states, origin, target) for target in targets])
    assert 40 < seen.sum() < 190
    sums = np.zeros((1, 12, 24))
    weights = np.ones(len(targets))
    coarse_views.gather_directions(states, origin[None], targets, weights, 40.0, 300, sums)
    # The kernel steps by half a voxel, so it overlooks a wall that is grazed by less.
    assert seen.sum() <= sums.sum() <= seen.sum() + 4


def test_weights_go_to_the_direction_of_their_target() -> None:
    states, origin = np.full((20, 20, 20), FREE, np.uint8), np.array((10.5, 10.5, 10.5))
    directions = np.array([(1.0, 0.1, 0.1), (-0.2, 1.0, 0.3), (0.2, -0.3, -1.0)])
    sums = np.zeros((1, 12, 24))
    coarse_views.gather_directions(
        states, origin[None], origin + 5.0 * directions, np.array([1.0, 2.0, 4.0]), 40.0, 9, sums
    )
    azimuths = np.arctan2(directions[:, 1], directions[:, 0]) / (2.0 * np.pi) + 0.5
    elevations = np.arcsin(directions[:, 2] / np.linalg.norm(directions, axis=1)) / np.pi + 0.5
    expected = np.zeros((12, 24))
    for azimuth, elevation, weight in zip(azimuths, elevations, (1.0, 2.0, 4.0), strict=True):
        expected[int(elevation * 12), int(azimuth * 24)] = weight
    np.testing.assert_array_equal(sums[0], expected)


def test_targets_out_of_range_do_not_count() -> None:
    states, origin = np.full((20, 20, 20), FREE, np.uint8), np.array([[2.5, 2.5, 2.5]])
    targets, sums = np.array([(6.5, 2.5, 2.5), (9.5, 2.5, 2.5)]), np.zeros((1, 2, 2))
    coarse_views.gather_directions(states, origin, targets, np.ones(2), 5.0, 9, sums)
    assert sums.sum() == 1.0


def test_marked_voxels_are_those_in_sight(rng: np.random.Generator) -> None:
    states, origin = walled(), np.array((5.2, 6.1, 9.7))
    places = rng.integers(1, 19, (150, 3))
    seen = np.empty(len(places), np.bool_)
    coarse_views.mark_in_sight(states, origin, places, seen)
    expected = [seen_by_sampling(states, origin, place + 0.5) for place in places]
    assert np.mean(seen == expected) > 0.95


def coarse_view(
    states: np.ndarray, kinds: np.ndarray, weights: np.ndarray, high: float
) -> np.ndarray:
    """One ray along x from (2.5, 10.5, 10.5), 12 voxels long."""
    sums = np.zeros((1, 5))
    bounds = np.array([[-np.inf] * 3, [high, np.inf, np.inf]])
    coarse_views.coarse_view(
        states,
        kinds,
        weights,
        bounds,
        np.array([(2.5, 10.5, 10.5)]),
        np.array([[(1.0, 0.0, 0.0)]]),
        12.0,
        0.01,
        4.0,
        2,
        sums,
    )
    return sums[0]


def cubes(first: float, last: float) -> float:
    return (last**3 - first**3) / 3.0


def test_glance_sums_volumes_up_to_the_first_obstacle() -> None:
    states = np.full((20, 20, 20), FREE, np.uint8)
    states[7:] = UNKNOWN
    states[11] = OCCUPIED
    unknown, known, told, wanted, left = coarse_view(
        states, np.empty((0, 0, 0), np.uint8), np.ones((1, 2)), np.inf
    )
    assert unknown == pytest.approx(cubes(4.5, 8.5), rel=0.01)
    obstacle = 8.5**2 * 0.01  # its first step is seen
    assert known == pytest.approx(cubes(0.0, 4.5) + obstacle, rel=0.01)
    r = np.arange(4.5, 8.5, 0.001)
    behind = (r**2 * np.exp(-(r - 4.5) / 4.0)).sum() * 0.001
    assert told == pytest.approx(behind, rel=0.02)
    assert wanted == told == left


def test_glance_weighs_what_it_sees() -> None:
    states = np.full((20, 20, 20), UNKNOWN, np.uint8)
    kinds = np.zeros(states.shape, np.uint8)
    kinds[8:] = 1
    weights = np.array([(1.0, 1.0), (3.0, 0.5)])
    _, _, told, wanted, left = coarse_view(states, kinds, weights, np.inf)
    _, _, near, _, _ = coarse_view(states, kinds, weights, 8.0)
    assert wanted == pytest.approx(near + 3.0 * (told - near), rel=1e-6)
    assert left == pytest.approx(near + 1.5 * (told - near), rel=1e-6)


def test_kernels_mean_the_same_uncompiled(rng: np.random.Generator) -> None:
    states = rng.choice([FREE, UNKNOWN, OCCUPIED], (8, 8, 8), p=(0.7, 0.25, 0.05)).astype(np.uint8)
    directions = rng.normal(size=(2, 5, 3))
    directions /= np.linalg.norm(directions, axis=-1, keepdims=True)
    origins = rng.uniform(1.0, 7.0, (2, 3))
    bounds = np.array([[1.0] * 3, [7.0] * 3])
    kinds, weights = np.empty((0, 0, 0), np.uint8), np.ones((1, 2))
    plain, compiled = np.zeros((2, 5)), np.zeros((2, 5))
    for function, sums in (
        (coarse_views.coarse_view.py_func, plain),
        (coarse_views.coarse_view, compiled),
    ):
        function(states, kinds, weights, bounds, origins, directions, 9.0, 0.5, 3.0, 2, sums)
    assert plain.min(axis=0)[:3].max() > 0.0
    np.testing.assert_allclose(compiled, plain, rtol=1e-12)
