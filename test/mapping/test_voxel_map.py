"""The voxel map as a whole: questions, changes, save and resume."""

from __future__ import annotations

import numpy as np
import pytest

from infomap_ros.errors import ConfigError, InvalidInputError, MapFileError
from infomap_ros.geometry import PinholeCamera, PoseUncertainty
from infomap_ros.mapping import (
    LOG_ODDS_QUANTUM,
    SHARED_LOG_ODDS_LIMIT,
    VoxelChanges,
    VoxelMap,
    VoxelMapConfig,
)
from infomap_ros.mapping.voxels.surface import LIMIT

from .scenes import random_pose, random_scene

CAMERA = PinholeCamera(64, 48, 50.0, 50.0, 31.5, 23.5)
CONFIG = VoxelMapConfig(voxel_size=0.06, max_range=2.5, default_sigma=0.01)
SIZE = CONFIG.voxel_size


def looks(seed: int, count: int) -> list[tuple[np.ndarray, np.ndarray]]:
    rng = np.random.default_rng(seed)
    scene = random_scene(rng)
    poses = [random_pose(rng) for _ in range(count)]
    return [(scene.points(CAMERA, pose), pose) for pose in poses]


INDEPENDENT = PoseUncertainty(np.zeros((6, 6)), white=np.eye(6) * 1e-6)


def integrate_all(voxel_map: VoxelMap, scans: list[tuple[np.ndarray, np.ndarray]]) -> VoxelMap:
    for number, (points, pose) in enumerate(scans):
        camera = CAMERA if number % 3 else None
        voxel_map.integrate(points, pose, pose_covariance=INDEPENDENT, camera=camera)
    return voxel_map


@pytest.fixture(scope="module")
def room() -> VoxelMap:
    """A room seen three times; not to be changed."""
    return integrate_all(VoxelMap(CONFIG), looks(1, 3))


def centers(indices: np.ndarray) -> np.ndarray:
    return (indices + 0.5) * SIZE


def assert_identical(left: VoxelMap, right: VoxelMap) -> None:
    for a, b in zip(left.voxels(), right.voxels(), strict=True):
        np.testing.assert_array_equal(a, b)
    for a, b in zip(left.gaussians(), right.gaussians(), strict=True):
        np.testing.assert_array_equal(a, b)


# Questions.


def test_an_empty_map_knows_nothing():
    empty = VoxelMap(CONFIG)
    points = np.array([[0.0, 0.0, 0.0], [1e9, 0.0, 0.0]])
    assert empty.probability(points).tolist() == [0.5, 0.5]
    assert empty.log_odds(points).tolist() == [0.0, 0.0]
    assert not empty.is_known(points).any()
    assert (empty.known_voxels, empty.surface_voxels, empty.entropy_bits()) == (0, 0, 0.0)
    assert empty.bounds() is None
    assert [len(part) for part in empty.voxels()] == [0, 0]
    assert [len(part) for part in empty.gaussians()] == [0, 0, 0]


def test_points_anywhere_in_a_voxel_ask_that_voxel(room, rng):
    indices, log_odds = room.voxels()
    chosen = rng.integers(len(indices), size=2000)
    points = (indices[chosen] + rng.uniform(0.001, 0.999, (2000, 3))) * SIZE
    np.testing.assert_array_equal(room.log_odds(points), log_odds[chosen])
    assert room.is_known(points).all()
    known = {tuple(index) for index in indices.tolist()}
    assert len(known) == len(indices) == room.known_voxels


def test_probability_is_that_of_the_log_odds(room):
    indices, log_odds = room.voxels()
    odds = np.exp(log_odds.astype(np.float64))
    np.testing.assert_allclose(room.probability(centers(indices)), odds / (1.0 + odds), rtol=1e-12)
    assert set(np.sign(log_odds)) >= {-1.0, 1.0}


def test_evidence_of_a_scan_is_that_of_the_configuration():
    voxel_map = VoxelMap(VoxelMapConfig(voxel_size=0.05, probability_hit=0.9, probability_miss=0.3))
    points = CAMERA.back_project(np.full((48, 64), 1.025))
    for _ in range(3):
        voxel_map.integrate(points, np.eye(4), np.full((48, 64, 6), [1, 0, 0, 1, 0, 1]) * 1e-8)
    hit, miss = (
        LOG_ODDS_QUANTUM * round(np.log(p / (1.0 - p)) / LOG_ODDS_QUANTUM) for p in (0.9, 0.3)
    )
    assert voxel_map.log_odds([[0.01, 0.01, 1.03]]) == pytest.approx(3 * hit)
    assert voxel_map.log_odds([[0.01, 0.01, 0.5]]) == pytest.approx(3 * miss)


def test_outside_of_the_coordinates_and_nan_are_unknown(room):
    points = [[1e9, 0.0, 0.0], [np.nan, 0.0, 0.0], [-np.inf, 0.0, 0.0]]
    assert not room.is_known(points).any()
    assert room.probability(points).tolist() == [0.5] * 3


def test_bounds_hold_all_known_voxels_and_little_more(room):
    indices, _ = room.voxels()
    low, high = room.bounds()
    assert (indices.min(axis=0) >= low).all() and (indices.max(axis=0) <= high).all()
    assert (indices.min(axis=0) - low < 8).all() and (high - indices.max(axis=0) < 8).all()


def test_entropy_is_the_sum_over_the_voxels(room):
    p = room.probability(centers(room.voxels()[0]))
    expected = -(p * np.log2(p) + (1.0 - p) * np.log2(1.0 - p)).sum()
    assert room.entropy_bits() == pytest.approx(expected, rel=1e-9)


def test_entropy_of_a_region_counts_a_bit_for_each_unknown_voxel(room):
    low, high = np.array([-0.511, 0.013, -0.77]), np.array([2.302, 0.881, 0.95])
    indices, _ = room.voxels()
    inside = ((centers(indices) >= low) & (centers(indices) < high)).all(axis=1)
    p = room.probability(centers(indices[inside]))
    known = -(p * np.log2(p) + (1.0 - p) * np.log2(1.0 - p)).sum()
    grid = [np.arange(-100, 100)] * 3
    all_inside = np.prod(
        [
            ((centers(g) >= a) & (centers(g) < b)).sum()
            for g, a, b in zip(grid, low, high, strict=True)
        ]
    )
    expected = known + all_inside - inside.sum()
    assert room.entropy_bits([low, high]) == pytest.approx(expected, rel=1e-9)
    assert 0 < inside.sum() < all_inside


@pytest.mark.parametrize(
    "region",
    [[[0, 0, 0]], [[0, 0, 0], [1, 1, np.nan]], [[0, 0, 0], [1, -1, 1]], [[0, 0], [1, 1]]],
)
def test_a_region_that_is_no_box_is_refused(room, region):
    with pytest.raises(InvalidInputError, match="region"):
        room.entropy_bits(region)


@pytest.mark.parametrize("points", [[1.0, 2.0, 3.0], [[1.0, 2.0]], np.zeros((2, 2, 3))])
def test_questions_about_misshapen_points_are_refused(room, points):
    for question in (room.probability, room.log_odds, room.is_known):
        with pytest.raises(InvalidInputError, match="points"):
            question(points)


def test_reset_forgets_everything():
    voxel_map = integrate_all(VoxelMap(CONFIG), looks(2, 2))
    voxel_map.reset()
    assert voxel_map.known_voxels == 0
    integrate_all(voxel_map, looks(1, 3))
    fresh = integrate_all(VoxelMap(CONFIG), looks(1, 3))
    assert_identical(voxel_map, fresh)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("voxel_size", 0.0),
        ("voxel_size", float("nan")),
        ("max_range", -1.0),
        ("probability_hit", 0.5),
        ("probability_miss", 0.5),
        ("error_correlation", 1.1),
        ("threads", 0),
        ("memory_limit", 0.0),
    ],
)
def test_impossible_parameters_are_refused(name, value):
    with pytest.raises(ConfigError, match=name):
        VoxelMapConfig(**{name: value})


# Save, load, resume.


def test_a_map_resumes_as_if_it_had_never_stopped(tmp_path):
    scans = looks(3, 6)
    through = integrate_all(integrate_all(VoxelMap(CONFIG), scans[:3]), scans[3:])
    first = integrate_all(VoxelMap(CONFIG), scans[:3])
    first.save(tmp_path / "room.map")
    resumed = VoxelMap.load(tmp_path / "room.map")
    assert resumed.config == CONFIG
    assert_identical(resumed, first)
    integrate_all(resumed, scans[3:])
    assert_identical(resumed, through)
    assert resumed.entropy_bits() == through.entropy_bits()


def test_a_loaded_map_is_no_larger_than_the_saved_one(room, tmp_path):
    room.save(tmp_path / "room.map")
    assert VoxelMap.load(tmp_path / "room.map").memory_bytes() <= 1.05 * room.memory_bytes()


@pytest.mark.parametrize("tracked_first", [True, False])
def test_an_empty_map_that_was_loaded_grows_and_tracks_changes(tmp_path, tracked_first):
    VoxelMap(CONFIG).save(tmp_path / "empty.map")
    resumed = VoxelMap.load(tmp_path / "empty.map")
    if tracked_first:
        resumed.track_changes(True)
    integrate_all(resumed, looks(1, 3))
    assert_identical(resumed, integrate_all(VoxelMap(CONFIG), looks(1, 3)))
    if tracked_first:
        assert len(resumed.take_changes().indices) == resumed.known_voxels


def test_state_is_a_copy(room):
    state = room.state()
    before = room.voxels()[1]
    for array in state.values():
        array[...] = 0
    np.testing.assert_array_equal(room.voxels()[1], before)


@pytest.mark.parametrize(
    ("name", "damage"),
    [
        ("block_base", lambda a: a[:-1]),
        ("block_plane", lambda a: a + 10**6),
        ("block_kind", lambda a: a + 7),
        ("block_keys", np.zeros_like),
        ("narrow", lambda a: a.astype(np.int16)),
        ("gaussian_owner", lambda a: a + np.uint32(2**30)),
        ("gaussian_information", lambda a: a * np.float32(np.nan)),
        ("gaussian_excess", lambda a: a - np.float32(1.0)),
        ("gaussian_memory", lambda a: a[:-1]),
        ("offset", lambda a: a[:-1]),
        ("free_rows", None),
    ],
)
def test_arrays_that_contradict_each_other_are_refused(room, name, damage):
    state = room.state()
    if damage is None:
        del state[name]
    else:
        state[name] = damage(state[name])
    with pytest.raises(MapFileError, match="map state"):
        VoxelMap.from_state(CONFIG, state)


# Changes.


class Replica:
    """What one learns of a map from its changes alone."""

    def __init__(self) -> None:
        self.log_odds: dict[tuple[int, ...], int] = {}
        self.surface: dict[tuple[int, ...], tuple[np.ndarray, np.ndarray]] = {}

    def apply(self, changes: VoxelChanges) -> None:
        """Replace the values of the changed voxels."""
        for n, index in enumerate(map(tuple, changes.indices.tolist())):
            self.log_odds[index] = int(changes.log_odds[n])
            if changes.has_gaussian[n]:
                self.surface[index] = (changes.means[n], changes.covariances[n])
            else:
                self.surface.pop(index, None)
                assert np.isnan(changes.means[n]).all()
                assert np.isnan(changes.covariances[n]).all()

    def assert_equals(self, voxel_map: VoxelMap) -> None:
        """Compare evidence (clipped) and Gaussians."""
        indices, log_odds = voxel_map.voxels()
        limit = SHARED_LOG_ODDS_LIMIT
        quanta = np.clip(np.rint(log_odds / LOG_ODDS_QUANTUM), -limit, limit).astype(int)
        expected = dict(zip(map(tuple, indices.tolist()), quanta.tolist(), strict=True))
        heard = {index: value for index, value in self.log_odds.items() if index in expected}
        assert heard == expected
        unknown = [value for index, value in self.log_odds.items() if index not in expected]
        assert not any(unknown), "a voxel without occupancy evidence"
        surface, means, covariances = voxel_map.gaussians()
        assert self.surface.keys() == set(map(tuple, surface.tolist()))
        for index, mean, covariance in zip(surface.tolist(), means, covariances, strict=True):
            np.testing.assert_array_equal(self.surface[tuple(index)][0], mean)
            np.testing.assert_array_equal(self.surface[tuple(index)][1], covariance)


def tracking(config: VoxelMapConfig = CONFIG) -> VoxelMap:
    voxel_map = VoxelMap(config)
    voxel_map.track_changes(True)
    return voxel_map


def test_replaying_the_changes_makes_the_map():
    voxel_map, replica = tracking(), Replica()
    for scan in looks(4, 7) * 2:
        integrate_all(voxel_map, [scan])
        integrate_all(voxel_map, [scan, scan])
        replica.apply(voxel_map.take_changes())
        replica.assert_equals(voxel_map)
    assert max(replica.log_odds.values()) == SHARED_LOG_ODDS_LIMIT
    assert min(replica.log_odds.values()) == -SHARED_LOG_ODDS_LIMIT


def test_voxels_of_blocks_that_are_marked_are_taken_again():
    voxel_map = integrate_all(tracking(), looks(5, 2))
    everything = set(map(tuple, voxel_map.take_changes().indices.tolist()))
    taken, first, left = set(), 0, 1
    while left:
        left = voxel_map.mark_changed(first, 7)
        piece = set(map(tuple, voxel_map.take_changes().indices.tolist()))
        assert not taken & piece
        taken, first = taken | piece, first + 7
    assert taken == everything


def test_every_changed_voxel_is_taken_once():
    voxel_map = integrate_all(tracking(), looks(5, 2))
    changes = voxel_map.take_changes()
    assert len(np.unique(changes.indices, axis=0)) == len(changes.indices)
    assert len(voxel_map.take_changes().indices) == 0
    before = dict(
        zip(map(tuple, voxel_map.voxels()[0].tolist()), voxel_map.voxels()[1], strict=True)
    )
    integrate_all(voxel_map, looks(6, 1))
    taken = set(map(tuple, voxel_map.take_changes().indices.tolist()))
    indices, log_odds = voxel_map.voxels()
    changed = {
        tuple(index)
        for index, value in zip(indices.tolist(), log_odds, strict=True)
        if before.get(tuple(index)) != value
    }
    assert changed <= taken


def test_changes_come_in_portions():
    voxel_map, replica = integrate_all(tracking(), looks(7, 2)), Replica()
    sizes = []
    while len((changes := voxel_map.take_changes(1000)).indices):
        sizes.append(len(changes.indices))
        replica.apply(changes)
    assert set(sizes[:-1]) == {1000} and sizes[-1] <= 1000
    assert len(replica.log_odds) == sum(sizes)
    replica.assert_equals(voxel_map)
    assert len(voxel_map.take_changes(0).indices) == 0


def test_tracking_does_not_change_the_map():
    assert_identical(
        integrate_all(tracking(), looks(8, 3)), integrate_all(VoxelMap(CONFIG), looks(8, 3))
    )


def test_evidence_beyond_what_is_told_is_no_change():
    voxel_map, (scan, other) = tracking(), looks(9, 2)
    for _ in range(25):
        voxel_map.integrate(*scan, camera=CAMERA)
        voxel_map.integrate(*other, camera=CAMERA)
    voxel_map.take_changes()
    free_before = voxel_map.voxels()
    voxel_map.integrate(*scan, camera=CAMERA)
    changes = voxel_map.take_changes()
    free = free_before[1] <= -SHARED_LOG_ODDS_LIMIT * LOG_ODDS_QUANTUM
    told = set(map(tuple, changes.indices.tolist()))
    again = [index for index in map(tuple, free_before[0][free].tolist()) if index in told]
    assert len(again) < 0.05 * free.sum()


@pytest.mark.parametrize("camera", [CAMERA, None])
def test_images_from_one_place_are_no_more_witnesses_than_a_few(camera):
    (points, pose), few, many = looks(9, 1)[0], VoxelMap(CONFIG), VoxelMap(CONFIG)
    for number in range(60):
        many.integrate(points, pose, camera=camera)
        if number < LIMIT:
            few.integrate(points, pose, camera=camera)
    evidence = many.voxels()[1]
    np.testing.assert_array_equal(evidence, few.voxels()[1])
    assert np.abs(evidence).max() <= LIMIT * CONFIG.hit_quanta * LOG_ODDS_QUANTUM
    assert (evidence < 0.0).any() and (evidence > 0.0).any()


def test_changes_survive_a_reset_of_tracking():
    voxel_map = integrate_all(tracking(), looks(5, 1))
    voxel_map.reset()
    assert len(voxel_map.take_changes().indices) == 0
    integrate_all(voxel_map, looks(5, 1))
    assert len(voxel_map.take_changes().indices) >= voxel_map.known_voxels


def test_changes_that_are_not_tracked_cannot_be_taken(room):
    with pytest.raises(InvalidInputError, match="not tracked"):
        room.take_changes()
