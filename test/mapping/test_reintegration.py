"""Correcting a map when the poses of its scans turn out to have been wrong.

The oracle is a map that is made from the same scans and the corrected poses from the start.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pytest

from infomap_ros.errors import CapacityError, InvalidInputError
from infomap_ros.geometry import PinholeCamera, perturb_transform
from infomap_ros.mapping import NOT_OBSERVED, VoxelMap, VoxelMapConfig
from infomap_ros.mapping import NOT_OBSERVED as NOT_OBSERVED_ON_THE_WIRE
from infomap_ros.mapping.correction import reintegration
from infomap_ros.mapping.correction.reintegration import (
    Reintegration,
    ReintegrationReport,
    corrections,
    moved_scans,
)
from infomap_ros.mapping.correction.scan_store import ScanStore, ScanStoreConfig, integrate_record
from infomap_ros.team.replica import MapReplica
from infomap_ros.team.update import MapUpdate
from infomap_ros.team.wire import decode_update, encode_update
from test.mapping.scenes import Scene, look_at, random_scene
from test.mapping.voxels import voxels_of


def every_moved(store, new_poses, voxel_map):
    """As `moved_scans`, of which any correction is large enough."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(reintegration, "_MIN_CORRECTION", 0.0)
        return moved_scans(store, new_poses, voxel_map)


def reintegrate(voxel_map, store, new_poses, which=moved_scans) -> ReintegrationReport:
    """Move scans to new poses at once."""
    moved = which(store, new_poses, voxel_map)
    return Reintegration(voxel_map, store, moved).finish()


CAMERA = PinholeCamera(64, 48, 50.0, 50.0, 31.5, 23.5)
CONFIG = VoxelMapConfig(voxel_size=0.08, max_range=3.0)
SIGMA = np.diag([1e-4] * 3 + [1e-5] * 3)


class Trip:
    """Scans of a scene along a way, integrated from poses that are partly wrong."""

    def __init__(self, scene: Scene, true_poses: list, used_poses: list, **store) -> None:  # type: ignore[no-untyped-def, type-arg]
        self.scene, self.true, self.used = scene, true_poses, used_poses
        self.map = VoxelMap(CONFIG)
        self.map.track_changes(True)
        self.store = ScanStore(CONFIG, **store)
        for stamp in range(len(true_poses)):
            self.scan(stamp)

    def scan(self, stamp: int) -> None:
        points = self.scene.points(CAMERA, self.true[stamp])
        self.store.integrate(self.map, stamp, points, self.used[stamp], None, SIGMA, CAMERA, 0.3)
        self.store.freeze_excess()

    def made_anew(self, base: VoxelMap | None = None) -> VoxelMap:
        """The map that the scans of the store make from where they are now."""
        fresh = VoxelMap.from_state(CONFIG, base.state()) if base else VoxelMap(CONFIG)
        for scan in self.store:
            integrate_record(fresh, scan.record, scan.transform, scan.uncertainty)
        return fresh


def _trip(seed: int, count: int = 6, error: float = 0.1, first: int = 2, **store) -> Trip:  # type: ignore[no-untyped-def]
    """A walk through a random room on which the poses from scan `first` on are wrong."""
    rng = np.random.default_rng(seed)
    true = [look_at(rng.uniform(-0.6, 0.6, 3), rng.normal(size=3)) for _ in range(count)]
    used = [
        perturb_transform(pose, rng.normal(0.0, error, 6)) if stamp >= first else pose
        for stamp, pose in enumerate(true)
    ]
    return Trip(random_scene(rng), true, used, **store)


def _true_poses(trip: Trip) -> Mapping[int, tuple[np.ndarray, None]]:
    return {(stamp, ""): (pose, None) for stamp, pose in enumerate(trip.true)}


def _is_same(first: VoxelMap, second: VoxelMap) -> bool:
    """Whether two maps hold the same voxels and Gaussians, to the bit."""
    return voxels_of(first) == voxels_of(second)


@pytest.mark.parametrize("seed", range(6))
def test_the_map_is_that_of_the_corrected_poses_to_the_bit(seed: int) -> None:
    trip = _trip(seed)
    report = reintegrate(trip.map, trip.store, _true_poses(trip), every_moved)
    expected = VoxelMap(CONFIG)
    for scan, pose in zip(trip.store, trip.true, strict=True):
        integrate_record(expected, scan.record, pose, scan.uncertainty)
    assert _is_same(trip.map, expected)
    assert report.scans_moved >= 4
    assert report.blocks_rebuilt > 0


def test_blocks_that_no_moved_scan_touches_are_left_alone() -> None:
    rng = np.random.default_rng(3)
    ahead, back = look_at([1, 0, 0], [2, 0, 0]), look_at([-1, 0, 0], [-2, 0, 0])
    wrong = perturb_transform(ahead, rng.normal(0.0, 0.05, 6))
    scene = Scene([(1.0, 0.0, 0.0, 2.5), (1.0, 0.0, 0.0, -2.5)])
    trip = Trip(scene, [back, back, ahead], [back, back, wrong])
    report = reintegrate(trip.map, trip.store, {(2, ""): (ahead, None)})
    assert report.scans_moved == report.scans_integrated == 1
    assert report.blocks_rebuilt < len(trip.map.state()["block_keys"])
    assert _is_same(trip.map, trip.made_anew())


def test_no_ghost_of_the_old_surface_stays() -> None:
    wall = Scene([(1.0, 0.0, 0.0, 2.0)])
    ahead = look_at([0, 0, 0], [1, 0, 0])
    drifted = ahead.copy()
    drifted[0, 3] -= 0.4
    trip = Trip(wall, [ahead] * 5, [drifted, drifted, drifted, ahead, ahead])

    def ghosts() -> int:
        _, means, _ = trip.map.gaussians()
        return int(np.count_nonzero(np.abs(means[:, 0] - 2.0) > 0.1))

    before = ghosts()
    reintegrate(trip.map, trip.store, {(stamp, ""): (ahead, None) for stamp in range(3)})
    assert before > 100
    assert ghosts() == 0


def test_corrections_below_the_threshold_move_nothing() -> None:
    trip = _trip(1, error=0.004)
    before = voxels_of(trip.map)
    assert reintegrate(trip.map, trip.store, _true_poses(trip)).scans_moved == 0
    assert voxels_of(trip.map) == before


def test_small_corrections_add_up_to_one_that_counts() -> None:
    trip = _trip(2, count=1)
    moved = []
    for step in range(1, 5):
        pose = trip.used[0].copy()
        pose[0, 3] += 0.3 * step * 0.08
        moved.append(reintegrate(trip.map, trip.store, {(0, ""): (pose, None)}).scans_moved)
    assert moved == [0, 1, 0, 1]


def test_a_new_covariance_comes_with_the_new_pose() -> None:
    trip = _trip(4)
    better = {(stamp, ""): (pose, 0.01 * SIGMA) for stamp, pose in enumerate(trip.true)}
    reintegrate(trip.map, trip.store, better, every_moved)
    assert all(np.allclose(s.uncertainty.covariance, 0.01 * SIGMA) for s in list(trip.store)[2:])
    assert _is_same(trip.map, trip.made_anew())


def test_a_replica_follows_and_learns_what_is_no_longer_observed() -> None:
    trip = _trip(5)
    replica = MapReplica(CONFIG)
    taken_back = 0
    for version in (1, 2):
        changes = trip.map.take_changes()
        taken_back = int(np.count_nonzero(changes.log_odds == NOT_OBSERVED))
        update = MapUpdate.of_changes(changes, CONFIG.voxel_size, 7, version)
        for rows in encode_update(update):
            replica.apply(decode_update(rows))
        assert replica.voxel_map.known_voxels == trip.map.known_voxels
        reintegrate(trip.map, trip.store, _true_poses(trip))
    assert taken_back > 0
    known, evidence = trip.map.voxels()
    centers = (known + 0.5) * CONFIG.voxel_size
    assert replica.voxel_map.is_known(centers).all()
    assert np.allclose(replica.voxel_map.log_odds(centers), np.clip(evidence, -5.0, 5.0))


def test_who_comes_late_is_told_what_is_no_longer_observed() -> None:
    trip = _trip(5)
    reintegrate(trip.map, trip.store, _true_poses(trip))
    first = trip.map.take_changes()
    trip.map.mark_changed(0, 1 << 20)
    again = trip.map.take_changes()
    gone = first.log_odds == NOT_OBSERVED
    told = {tuple(i) for i in again.indices[again.log_odds == NOT_OBSERVED].tolist()}
    assert gone.any()
    assert {tuple(i) for i in first.indices[gone].tolist()} <= told


def test_only_voxels_that_are_other_than_before_count_as_changed() -> None:
    trip = _trip(6)
    before = voxels_of(trip.map)
    trip.map.take_changes()
    reintegrate(trip.map, trip.store, _true_poses(trip))
    after = voxels_of(trip.map)
    changes = trip.map.take_changes()
    told = {tuple(index) for index in changes.indices.tolist()}
    other = {i for i in before.keys() | after.keys() if before.get(i) != after.get(i)}
    gone = before.keys() - after.keys()
    assert told <= other
    assert gone <= told


def test_what_has_no_scans_stays_as_a_base() -> None:
    loaded = _trip(7).map
    trip = Trip.__new__(Trip)
    other = _trip(8)
    trip.__dict__.update(other.__dict__)
    trip.map = VoxelMap.from_state(CONFIG, loaded.state())
    trip.store = ScanStore(CONFIG, base=loaded)
    for stamp in range(len(trip.true)):
        trip.scan(stamp)
    reintegrate(trip.map, trip.store, _true_poses(trip), every_moved)
    assert _is_same(trip.map, trip.made_anew(loaded))


def test_frozen_scans_stay_where_they_are() -> None:
    size = next(iter(_trip(9).store)).record.memory_bytes()
    trip = _trip(9, config=ScanStoreConfig(memory=4.5 * size * 1e-9))
    assert trip.store.frozen >= 1
    reintegrate(trip.map, trip.store, _true_poses(trip), every_moved)
    anew = trip.made_anew(trip.store.base)
    assert {i: v[0] for i, v in voxels_of(trip.map).items()} == {
        i: v[0] for i, v in voxels_of(anew).items()
    }


@pytest.mark.parametrize("seed", range(3))
def test_scans_may_be_added_while_the_map_is_corrected(seed: int) -> None:
    trip = _trip(10 + seed, count=8)
    late = [trip.true.pop() for _ in range(3)]
    fresh = Trip(trip.scene, trip.true, trip.used[:5])
    work = Reintegration(
        fresh.map, fresh.store, every_moved(fresh.store, _true_poses(fresh), fresh.map)
    )
    for number, pose in enumerate(late):
        work.step()
        fresh.true.append(pose)
        fresh.used.append(pose)
        fresh.scan(5 + number)
    work.finish()
    assert _is_same(fresh.map, fresh.made_anew())


def test_a_correction_that_does_not_fit_into_memory_leaves_the_map_alone() -> None:
    trip = _trip(11)
    fine = VoxelMapConfig(voxel_size=0.02, max_range=3.0)
    voxel_map, store = VoxelMap(fine), ScanStore(fine)
    for stamp, pose in enumerate(trip.used):
        points = trip.scene.points(CAMERA, trip.true[stamp])
        store.integrate(voxel_map, stamp, points, pose, None, SIGMA, CAMERA)
    before = voxels_of(voxel_map)
    voxel_map.config = VoxelMapConfig(voxel_size=0.02, max_range=3.0, memory_limit=0.001)
    with pytest.raises(CapacityError):
        reintegrate(voxel_map, store, _true_poses(trip), every_moved)
    assert voxels_of(voxel_map) == before
    assert np.array_equal(list(store)[-1].transform, trip.used[-1])


def test_a_new_pose_that_is_none_is_refused() -> None:
    trip = _trip(12, count=3)
    with pytest.raises(InvalidInputError, match="new poses"):
        reintegrate(trip.map, trip.store, {(2, ""): (np.ones((4, 4)), None)})


def test_a_corrected_map_can_be_saved_and_corrected_again(tmp_path) -> None:  # type: ignore[no-untyped-def]
    trip = _trip(13)
    reintegrate(trip.map, trip.store, _true_poses(trip), every_moved)
    trip.map.save(tmp_path / "map.infomap")
    assert _is_same(VoxelMap.load(tmp_path / "map.infomap"), trip.map)
    reintegrate(
        trip.map, trip.store, {(s, ""): (p, None) for s, p in enumerate(trip.used)}, every_moved
    )
    assert _is_same(trip.map, _trip(13).map)


def test_what_is_not_observed_is_told_as_the_wire_says_it() -> None:
    assert NOT_OBSERVED == NOT_OBSERVED_ON_THE_WIRE


def test_a_correction_bounds_how_far_points_move() -> None:
    rng = np.random.default_rng(14)
    trip = _trip(14, count=4)
    others = np.array([perturb_transform(pose, rng.normal(0.0, 0.3, 6)) for pose in trip.used])
    bounds = corrections(list(trip.store), others, CONFIG.max_range)
    for scan, other, bound in zip(trip.store, others, bounds, strict=True):
        points = scan.record.restore().points.reshape(-1, 3).astype(np.float64)
        points = points[np.linalg.norm(points, axis=1) <= CONFIG.max_range]
        change = other - scan.transform
        moves = np.linalg.norm(points @ change[:3, :3].T + change[:3, 3], axis=1)
        assert moves.max() <= bound + 1e-9
        assert bound < 4.0 * moves.max()
