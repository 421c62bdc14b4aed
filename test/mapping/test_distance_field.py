"""The distance field against scipy and against looking at every voxel."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.ndimage import distance_transform_edt

from infomap_ros.errors import InvalidInputError
from infomap_ros.geometry import Box, PlacedSolid, Sphere, make_transform
from infomap_ros.mapping.distance_field import distance_field, field_of_blocked
from infomap_ros.mapping.voxels.window import UNKNOWN_QUANTA, OccupancyThresholds, VoxelWindow

SIZE = 0.1
STRICT = OccupancyThresholds(surface_margin=0)


def distance_to_cubes(blocked: np.ndarray) -> np.ndarray:
    """scipy's distance from centers to cubes [voxels], on a grid of half voxels.

    The point of a cube that is nearest to a center has coordinates that are whole or half voxels.
    """
    fine = np.zeros([2 * n + 1 for n in blocked.shape], bool)
    for shift in np.ndindex(3, 3, 3):
        ends = [slice(s, s + 2 * n, 2) for s, n in zip(shift, blocked.shape, strict=True)]
        fine[tuple(ends)] |= blocked
    return 0.5 * distance_transform_edt(~fine)[1::2, 1::2, 1::2]


def naive_clearance(blocked: np.ndarray, points: np.ndarray, padding: int) -> np.ndarray:
    """Distance from points [voxels] to the nearest blocked cube, all looked at."""
    padded = np.pad(blocked, padding, constant_values=True) if padding else blocked
    low = np.argwhere(padded) - padding
    gaps = np.maximum(low - points[:, None], points[:, None] - low - 1)
    return np.linalg.norm(np.maximum(gaps, 0.0), axis=2).min(axis=1)


@pytest.mark.parametrize("share", [0.0005, 0.02, 0.4])
@pytest.mark.parametrize("shape", [(1, 1, 9), (17, 40, 23), (30, 3, 16)])
def test_distances_are_those_of_scipy(
    rng: np.random.Generator, shape: tuple[int, int, int], share: float
) -> None:
    blocked = rng.random(shape) < share
    blocked[tuple(np.array(shape) // 2)] = True
    field = field_of_blocked(blocked, (0, 0, 0), SIZE, outside_is_free=True)
    np.testing.assert_allclose(field.distances, SIZE * distance_to_cubes(blocked), atol=1e-5)


def test_everything_outside_is_blocked_unless_told_otherwise(rng: np.random.Generator) -> None:
    blocked = rng.random((12, 20, 9)) < 0.002
    field = field_of_blocked(blocked, (0, 0, 0), SIZE)
    around = distance_to_cubes(np.pad(blocked, 1, constant_values=True))[1:-1, 1:-1, 1:-1]
    np.testing.assert_allclose(field.distances, SIZE * around, atol=1e-5)


def test_nothing_blocked_is_infinitely_far() -> None:
    field = field_of_blocked(np.zeros((4, 5, 6), bool), (0, 0, 0), SIZE, outside_is_free=True)
    assert np.isinf(field.distances).all()
    assert field.spheres_clear([(0.2, 0.2, 0.2), (9.0, 0.0, 0.0)], 50.0).all()


@pytest.mark.parametrize("outside_is_free", [True, False])
def test_clearances_and_spheres_are_exact_off_the_grid(
    rng: np.random.Generator, outside_is_free: bool
) -> None:
    blocked = rng.random((14, 11, 18)) < 0.01
    first = np.array((-5, 3, 40))
    field = field_of_blocked(blocked, first, SIZE, outside_is_free)
    points = rng.uniform(-2.0, np.array(blocked.shape) + 2.0, (400, 3))
    naive = SIZE * naive_clearance(blocked, points, 0 if outside_is_free else 4)
    limit = 0.37
    placed = SIZE * (points + first)
    found = field.clearances(placed, limit)
    np.testing.assert_allclose(found, np.minimum(naive, limit), atol=1e-9)
    radii = rng.uniform(0.0, 0.3, 400)
    decided = np.abs(naive - radii) > 1e-6
    np.testing.assert_array_equal(
        field.spheres_clear(placed, radii)[decided], (naive > radii)[decided]
    )
    assert 50 < np.count_nonzero(naive > radii) < 350


def window(quanta: np.ndarray) -> VoxelWindow:
    return VoxelWindow(quanta.astype(np.int16), np.array((10, -4, 2)), SIZE)


def test_unknown_counts_as_blocked_unless_told_otherwise() -> None:
    quanta = np.full((5, 5, 5), -20)
    quanta[1, 2, 3] = UNKNOWN_QUANTA
    quanta[2, 2, 3] = 20
    quanta[3, 3, 3] = 20
    quanta[2, 0, 0] = 0
    zero = np.argwhere(distance_field(window(quanta), thresholds=STRICT).distances == 0.0)
    np.testing.assert_array_equal(zero, [(1, 2, 3), (2, 0, 0), (2, 2, 3), (3, 3, 3)])
    zero = np.argwhere(
        distance_field(window(quanta), thresholds=STRICT, unknown_is_free=True).distances == 0.0
    )
    np.testing.assert_array_equal(zero, [(2, 0, 0), (2, 2, 3), (3, 3, 3)])


def test_known_free_space_clears_all_that_is_not_occupied() -> None:
    quanta = np.full((8, 8, 8), UNKNOWN_QUANTA)
    quanta[4, 4, 4] = 20
    quanta[5, 4, 4] = -2  # seen through once: more likely free than not
    view = window(quanta)
    center = view.centers_of([(4, 4, 4)])[0]
    ball = PlacedSolid(Sphere(0.15), make_transform(np.eye(3), center))
    beyond = PlacedSolid(
        Box((1.0, 0.05, 0.05)), make_transform(np.eye(3), view.centers_of([(0, 0, 7)])[0])
    )
    free = distance_field(view, thresholds=STRICT, known_free=[ball, beyond]).distances > 0.0
    places = np.argwhere(np.ones(free.shape, bool))
    offsets = np.linalg.norm(places - 4, axis=1)
    expected = (offsets < 1.5) & (offsets > 0.0)
    expected |= (places[:, 1] == 0) & (places[:, 2] == 7) & (places[:, 0] <= 5)
    np.testing.assert_array_equal(free[tuple(places.T)], expected)


def test_voxels_that_hold_the_robot_are_free_whatever_was_seen_there() -> None:
    quanta = np.full((5, 5, 5), -20)
    quanta[2, 2, 2:4] = 20
    view = window(quanta)
    own = view.centers_of([(2, 2, 2), (9, 9, 9)]) + 0.04
    zero = np.argwhere(distance_field(view, thresholds=STRICT, own_points=own).distances == 0.0)
    np.testing.assert_array_equal(zero, [(2, 2, 3)])


def test_malformed_input_is_named() -> None:
    with pytest.raises(InvalidInputError, match="blocked"):
        field_of_blocked(np.zeros((3, 3), bool), (0, 0, 0), SIZE)
    field = field_of_blocked(np.zeros((3, 3, 3), bool), (0, 0, 0), SIZE)
    with pytest.raises(InvalidInputError, match="points"):
        field.clearances((1.0, 2.0, 3.0), 1.0)
