"""The ground found in maps whose ground is known."""

from __future__ import annotations

import numpy as np
import pytest

from infomap_ros.errors import InvalidInputError
from infomap_ros.geometry import PinholeCamera
from infomap_ros.mapping import FREE, OCCUPIED, UNKNOWN, VoxelMap, VoxelMapConfig
from infomap_ros.mapping.terrain import terrain as module
from infomap_ros.mapping.terrain.terrain import Terrain, terrain_of
from infomap_ros.mapping.voxels.state import VoxelStates, information_of, put_states

from .scenes import Scene, look_at
from .voxels import map_of

SIZE = 0.05
CAMERA = PinholeCamera(width=120, height=90, fx=75.0, fy=75.0, cx=59.5, cy=44.5)


def columns(shape: tuple[int, int, int], ground: np.ndarray | int) -> np.ndarray:
    """Solid up to and with voxel `ground` of each column, free above."""
    k = np.arange(shape[2])
    top = np.broadcast_to(ground, shape[:2])[:, :, None]
    return np.where(k <= top, OCCUPIED, FREE).astype(np.uint8) * np.ones(shape, np.uint8)


def found(states: np.ndarray, near: tuple[float, float, float], **constants: object) -> Terrain:
    """Terrain of a voxel array whose corner is the origin, cut to it."""
    with pytest.MonkeyPatch.context() as patch:
        for name, value in constants.items():
            patch.setattr(module, name, value)
        terrain = terrain_of(map_of(states, (0, 0, 0), SIZE), near)
    i, j = terrain.cells_of((SIZE / 2, SIZE / 2))
    part = np.s_[i : i + states.shape[0], j : j + states.shape[1]]
    grids = {
        name: getattr(terrain, name)[part]
        for name in ("heights", "sigma", "roughness", "step", "floor", "overhead", "seen")
    }
    return Terrain(**grids, origin=(0.0, 0.0), resolution=terrain.resolution, near=near)


def middle_of(k: np.ndarray | int) -> np.ndarray:
    return (np.asarray(k) + 0.5) * SIZE


def looked_at(scene: Scene, size: float) -> VoxelMap:
    """The map after a camera at 0.8 m has looked around and down."""
    voxel_map = VoxelMap(VoxelMapConfig(voxel_size=size, max_range=4.0))
    for angle in np.arange(0.0, 2.0 * np.pi, 0.7):
        for distance in (0.7, 1.8):
            target = distance * np.cos(angle), distance * np.sin(angle), 0.0
            pose = look_at((0.0, 0.0, 0.8), target)
            voxel_map.integrate(scene.points(CAMERA, pose), pose, camera=CAMERA)
    return voxel_map


@pytest.mark.parametrize("size", [0.05, 0.02])
def test_heights_of_a_slope_are_exact_within_their_sigma(size):
    """Errors far below the voxel's size: read off the Gaussians at the columns' middles."""
    normal = np.array([-0.2, 0.1, 1.0]) / np.linalg.norm([-0.2, 0.1, 1.0])
    terrain = terrain_of(looked_at(Scene(planes=[(*normal, 0.03)]), size), (0, 0, 0.1))
    cells = np.argwhere(np.isfinite(terrain.heights))
    middles = terrain.centers_of(cells)
    cells = cells[np.hypot(*middles.T) < 2.0]
    truth = (0.03 - terrain.centers_of(cells) @ normal[:2]) / normal[2]
    errors = terrain.heights[tuple(cells.T)] - truth
    assert len(cells) * terrain.resolution**2 > 0.9 * np.pi * 2.0**2
    assert np.sqrt((errors**2).mean()) < 0.005
    assert (np.abs(errors) < 3.0 * terrain.sigma[tuple(cells.T)]).mean() > 0.98
    assert abs(np.median(terrain.roughness[tuple(cells.T)])) < 0.003


def test_one_surface_per_column_is_found_from_anywhere(rng):
    shape = (24, 20, 40)
    ground = rng.integers(2, 12, shape[:2])
    states = columns(shape, ground)
    for i, j in ((0, 0), (12, 7), (23, 19)):
        terrain = found(states, (i * SIZE, j * SIZE, middle_of(ground[i, j] + 1)))
        np.testing.assert_allclose(terrain.heights, middle_of(ground), atol=1e-6)
        np.testing.assert_allclose(terrain.floor, (ground + 1) * SIZE, atol=1e-6)
        assert np.isinf(terrain.overhead).all()


def test_floor_under_a_table_is_found_and_the_table_above_it():
    states = columns((40, 40, 40), 2)
    states[10:25, 12:28, 18] = OCCUPIED
    terrain = found(states, (0.1, 0.1, 0.3))
    np.testing.assert_allclose(terrain.heights, middle_of(2), atol=1e-6)
    table = np.zeros((40, 40), bool)
    table[10:25, 12:28] = True
    np.testing.assert_allclose(terrain.overhead[table], 18 * SIZE, atol=1e-6)
    assert np.isinf(terrain.overhead[~table]).all()
    assert terrain.step.max() == 0.0


@pytest.mark.parametrize("above", [FREE, UNKNOWN])
def test_table_over_unseen_floor_is_no_ground(above):
    states = columns((40, 40, 40), 2)
    states[10:25, 12:28, :18] = UNKNOWN
    states[10:25, 12:28, 18] = OCCUPIED
    states[10:25, 12:28, 19:] = above
    terrain = found(states, (0.1, 0.1, 0.3))
    assert np.isnan(terrain.heights[10:25, 12:28]).all()
    clear = np.ones((40, 40), bool)
    clear[10:25, 12:28] = False
    np.testing.assert_allclose(terrain.heights[clear], middle_of(2), atol=1e-6)


def test_weak_hits_behind_a_ceiling_open_nothing():
    """A surface's noise puts some evidence behind it, at any height: that is no open space."""
    states = np.full((40, 40, 40), UNKNOWN, np.uint8)
    states[:, :, 6:12], states[:, :, 12] = FREE, OCCUPIED
    voxel_map = map_of(states, (0, 0, 0), SIZE)
    behind = np.indices((40, 40, 1), np.int32).reshape(3, -1).T + np.int32((0, 0, 13))
    evidence, nothing = np.full(len(behind), 3, np.int32), np.zeros((len(behind), 9), np.float32)
    put_states(voxel_map._storage, VoxelStates(behind, evidence > 0, evidence, nothing))
    terrain = terrain_of(voxel_map, (1.0, 1.0, 7.5 * SIZE))
    assert np.isnan(terrain.heights).all()


def test_floor_above_which_nothing_was_seen_is_ground():
    """As where rays come in at a grazing angle: they free nothing near the surface."""
    states = columns((40, 40, 40), 2)
    states[10:25, 12:28, 3:] = UNKNOWN
    terrain = found(states, (0.1, 0.1, 0.3))
    np.testing.assert_allclose(terrain.heights, middle_of(2), atol=1e-6)
    assert (terrain.seen[10:25, 12:28] <= 3 * SIZE + 1e-6).all()


def test_the_ceiling_of_a_vault_that_begins_at_the_floor_is_no_ground():
    """Where a robot has not seen the floor, next to itself, but the ceiling from below."""
    states = columns((60, 60, 50), 2)
    states[:40, 19:42] = UNKNOWN
    rows = np.arange(40)
    states[rows, 19:42, 42 - rows] = OCCUPIED
    terrain = found(states, (SIZE, 18 * SIZE, middle_of(6)))
    assert np.isnan(terrain.heights[:12, 19:42]).all()  # higher than a slope from the robot
    np.testing.assert_allclose(terrain.heights[:, :18], middle_of(2), atol=1e-6)
    np.testing.assert_allclose(terrain.heights[41:], middle_of(2), atol=1e-6)


def test_cave_that_descends_below_its_own_entrance():
    """Farther in, the ceiling is lower than the floor at the entrance."""
    along = np.arange(60)
    floor = np.broadcast_to((40 - along // 2)[:, None], (60, 10))
    k = np.arange(64)[None, None]
    is_open = (k > floor[..., None]) & (k < floor[..., None] + 14)
    states = np.where(is_open, FREE, OCCUPIED).astype(np.uint8)
    terrain = found(states, (0.1, 0.2, middle_of(42)))
    assert (floor[-1] + 14 < floor[0] + 1).all()
    np.testing.assert_allclose(terrain.heights, middle_of(floor), atol=1e-6)
    np.testing.assert_allclose(terrain.overhead, (floor + 14) * SIZE, atol=1e-6)


def test_of_two_storeys_that_of_the_robot_is_found():
    states = columns((30, 30, 50), 2)
    states[:, :, 25:27] = OCCUPIED
    lower = found(states, (0.5, 0.5, middle_of(4)))
    upper = found(states, (0.5, 0.5, middle_of(28)))
    np.testing.assert_allclose(lower.heights, middle_of(2), atol=1e-6)
    np.testing.assert_allclose(lower.overhead, 25 * SIZE, atol=1e-6)
    np.testing.assert_allclose(upper.heights, middle_of(26), atol=1e-6)


def test_ground_beyond_an_unmapped_strip_is_found_at_its_own_height():
    states = columns((30, 20, 30), 4)
    states[12:16] = UNKNOWN
    states[16:, :, 5:7] = OCCUPIED
    terrain = found(states, (0.1, 0.1, 0.5), _HOLE_CELLS=0)
    assert np.isnan(terrain.heights[12:16]).all()
    np.testing.assert_allclose(terrain.heights[16:], middle_of(6), atol=1e-6)


def test_specks_are_neither_ground_nor_obstacles(rng):
    states = columns((40, 40, 40), 3)
    for i, j in rng.choice(13 * 13, 25, replace=False)[:, None] // (13, 1) % 13 * 3:
        k = rng.integers(8, 35)
        states[i, j, k : k + rng.integers(1, 3)] = OCCUPIED
    clean = found(states, (0.5, 0.5, 0.3))
    np.testing.assert_allclose(clean.heights, middle_of(3), atol=1e-6)
    assert np.isinf(clean.overhead).all()
    assert np.isfinite(found(states, (0.5, 0.5, 0.3), _SPECK_CELLS=0).overhead).sum() == 25


@pytest.mark.parametrize(("evidence", "height"), [(3, 3), (9, 3), (18, 4)])
def test_voxel_that_was_not_hit_repeatedly_is_no_step(evidence, height):
    """One hit is 9 quanta, one miss takes 6."""
    voxel_map = map_of(columns((40, 40, 40), 3), (0, 0, 0), SIZE)
    bump = VoxelStates(
        np.array([[20, 20, 4]], np.int32),
        np.ones(1, bool),
        np.array([evidence], np.int32),
        np.zeros((1, 9), np.float32),
    )
    put_states(voxel_map._storage, bump)
    terrain = terrain_of(voxel_map, (0.5, 0.5, 0.3))
    assert terrain.height_at((20.5 * SIZE, 20.5 * SIZE)) == pytest.approx(middle_of(height))


def with_surface_above(normal: tuple[float, float, float], sigma: float, layers: int) -> VoxelMap:
    """Even ground whose height is known, a square of which is solid some layers higher.

    Args:
        normal: of the surfaces in the uppermost of these layers; (0, 0, 0) where it has none.
        sigma: of the ground's height [m].
        layers: number of them.
    """
    voxel_map = map_of(columns((40, 40, 40), 3), (0, 0, 0), SIZE)
    square = np.indices((6, 6, layers + 1), np.int32).reshape(3, -1).T + np.int32((15, 15, 3))
    is_ground, is_top = square[:, 2] == 3, square[:, 2] == 3 + layers
    means = (square + 0.5) * SIZE
    means[:, 2] = np.where(is_ground, 3.9 * SIZE, means[:, 2])
    spread = np.tile(np.diag((0.014, 0.014, sigma)) ** 2, (len(square), 1, 1))
    if any(normal):
        away = np.eye(3) - np.outer(normal, normal)
        spread[is_top] = 0.003**2 * np.outer(normal, normal) + 0.014**2 * away
    has_surface = is_ground | (is_top & any(normal))
    information = information_of(square, has_surface, means, spread, SIZE)
    quanta = np.full(len(square), 12, np.int32)
    put_states(voxel_map._storage, VoxelStates(square, quanta > 0, quanta, information))
    return voxel_map


@pytest.mark.parametrize(
    ("normal", "sigma", "layers", "height"),
    [
        ((0, 0, 0), 0.003, 2, 3.9 * SIZE),
        ((0, 0, 0), 0.003, 3, 3.9 * SIZE),
        ((0, 0, 0), 0.003, 4, 7.5 * SIZE),
        ((0, 0, 0), 0.03, 3, 6.5 * SIZE),
        ((0, 0, 1), 0.003, 3, 6.5 * SIZE),
        ((1, 0, 0), 0.003, 3, 6.5 * SIZE),
    ],
)
def test_what_doubtful_poses_made_solid_above_a_known_surface_is_no_step(
    normal, sigma, layers, height
):
    """It is one where a surface lies in it, be it upright, or where the ground is not known."""
    voxel_map = with_surface_above(normal, sigma, layers)
    terrain = terrain_of(voxel_map, (0.2, 0.2, 0.3))
    assert terrain.height_at((18.5 * SIZE, 17.5 * SIZE)) == pytest.approx(height, abs=1e-5)
    assert terrain.height_at((5.5 * SIZE, 5.5 * SIZE)) == pytest.approx(middle_of(3))


def test_pole_is_no_speck():
    states = columns((40, 40, 40), 3)
    states[20, 20, 4:30] = OCCUPIED
    states[30, 30, 12:15] = OCCUPIED
    terrain = found(states, (0.5, 0.5, 0.3))
    assert np.isnan(terrain.heights[20, 20])
    assert terrain.floor[20, 20] == np.inf and terrain.overhead[20, 20] < 5 * SIZE
    assert terrain.overhead[30, 30] == pytest.approx(12 * SIZE)


HOLE = (slice(15, 17), slice(15, 16))


def with_hole(below: int, ground: np.ndarray | int = 12) -> np.ndarray:
    """Ground with a hole of two cells, of which `below` states are known under the surface."""
    states = columns((30, 30, 30), ground)
    top = int(np.broadcast_to(ground, (30, 30))[HOLE].max())
    states[HOLE][..., : top + 1] = UNKNOWN
    states[HOLE][..., top + 1 - below : top + 1] = FREE
    return states


def test_small_hole_is_filled_where_all_around_agree():
    filled = found(with_hole(0), (0.1, 0.1, 0.8))
    np.testing.assert_allclose(filled.heights, middle_of(12), atol=1e-6)
    open_hole = found(with_hole(0), (0.1, 0.1, 0.8), _HOLE_CELLS=1)
    assert np.isnan(open_hole.heights[HOLE]).all()


def test_hole_into_which_one_sees_is_not_filled():
    assert np.isnan(found(with_hole(5), (0.1, 0.1, 0.8)).heights[HOLE]).all()


def test_hole_at_an_edge_is_not_filled():
    ground = np.where(np.arange(30) < 16, 12, 16)[:, None] * np.ones((1, 30), int)
    terrain = found(with_hole(0, ground), (0.1, 0.1, 0.8))
    assert np.isnan(terrain.heights[HOLE]).all()


def test_seen_ends_where_the_unknown_begins():
    states = columns((20, 20, 40), 2)
    states[5:10, 5:10, 14:] = UNKNOWN
    states[12, 12, 10:13] = UNKNOWN
    terrain = found(states, (0.1, 0.1, 0.3), _UNKNOWN_GAP=0.15)
    np.testing.assert_allclose(terrain.seen[5:10, 5:10], 14 * SIZE, atol=1e-6)
    assert terrain.seen[12, 12] == pytest.approx(terrain.seen[0, 0])
    strict = found(states, (0.1, 0.1, 0.3), _UNKNOWN_GAP=0.1)
    assert strict.seen[12, 12] == pytest.approx(10 * SIZE)


def test_wall_whose_top_was_not_seen_is_closed():
    states = columns((20, 20, 40), 2)
    states[10, :, 3:20], states[10, :, 20:] = OCCUPIED, UNKNOWN
    terrain = found(states, (0.1, 0.1, 0.3), _HOLE_CELLS=0)
    assert np.isnan(terrain.heights[10]).all()
    assert np.isinf(terrain.floor[10]).all()
    np.testing.assert_allclose(terrain.overhead[10], 2 * SIZE, atol=1e-6)


def test_empty_map_has_no_ground():
    terrain = terrain_of(VoxelMap(), (1.0, 2.0, 3.0))
    assert np.isnan(terrain.heights).all()
    assert terrain.near == (1.0, 2.0, 3.0)


def test_cells_and_middles_are_inverse(rng):
    terrain = found(columns((20, 20, 20), 2), (0.1, 0.1, 0.3))
    cells = rng.integers(0, 20, (30, 2))
    np.testing.assert_array_equal(terrain.cells_of(terrain.centers_of(cells)), cells)
    np.testing.assert_allclose(terrain.height_at(terrain.centers_of(cells)), middle_of(2), 1e-6)
    assert np.isnan(terrain.height_at((-1.0, 0.0)))


def test_nonsense_is_refused_by_name():
    with pytest.raises(InvalidInputError, match="near"):
        terrain_of(VoxelMap(), (0.0, np.nan, 0.0))
