"""Maps of several sessions add up to the map that one session would have made."""

from __future__ import annotations

import dataclasses
from collections import Counter
from collections.abc import Iterable
from itertools import permutations

import numpy as np
import pytest

from infomap_ros.errors import CapacityError, InvalidInputError
from infomap_ros.geometry import PinholeCamera, PoseUncertainty
from infomap_ros.geometry.pose_uncertainty import point_covariances
from infomap_ros.mapping import VoxelMap, VoxelMapConfig
from infomap_ros.mapping.voxels.keys import unpack
from infomap_ros.mapping.voxels.state import VoxelStates, put_states
from infomap_ros.mapping.voxels.surface import records_of
from infomap_ros.team.merging import NamedMap, merge_maps, sum_of_maps

from ..mapping.scenes import Scene, look_at

CONFIG = VoxelMapConfig(voxel_size=0.06, max_range=3.0)
CAMERA = PinholeCamera(64, 48, 50.0, 50.0, 31.5, 23.5)
SCENE = Scene([(1.0, 0.0, 0.0, 2.0), (0.1, 0.98, 0.0, 1.4), (0.0, 0.0, 1.0, -0.8)])
DRIFT = np.diag([1e-4] * 3 + [1e-5] * 3)


def fuse(
    voxel_map: VoxelMap,
    looks: Iterable[int],
    offset: float = 0.0,
    origin: int = 0,
) -> VoxelMap:
    """Look at the scene from numbered places, with errors of their own."""
    for look in looks:
        rng = np.random.default_rng(look)
        pose = look_at(rng.uniform(-0.3, 0.3, 3), [2.0, rng.uniform(0.0, 1.4), -0.3])
        points = SCENE.points(CAMERA, pose) * rng.normal(1.0, 0.003, (48, 64, 1))
        uncertainty = PoseUncertainty(DRIFT, offset=offset * np.eye(6), clock=float(look))
        voxel_map.integrate(points, pose, pose_covariance=uncertainty, camera=CAMERA)
    voxel_map.origin = origin
    return voxel_map


def session(looks: Iterable[int], offset: float = 0.0, origin: int = 0) -> VoxelMap:
    return fuse(VoxelMap(CONFIG), looks, offset, origin)


def merged(*maps: VoxelMap, has_common_frame: bool = False) -> VoxelMap:
    named = [NamedMap(f"map {number}", one) for number, one in enumerate(maps)]
    return merge_maps(named, has_common_frame)[0]


def occupancy(voxel_map: VoxelMap) -> dict[tuple[int, ...], float]:
    indices, log_odds = voxel_map.voxels()
    return dict(zip(map(tuple, indices.tolist()), log_odds.tolist(), strict=True))


def surface(voxel_map: VoxelMap) -> dict[tuple[int, ...], tuple[np.ndarray, np.ndarray]]:
    return {tuple(i): (m, c) for i, m, c in zip(*voxel_map.gaussians(), strict=True)}


def seen_from_one_side(voxel_map: VoxelMap) -> dict[tuple[int, ...], int]:
    """The side of each voxel with one record."""
    storage = voxel_map._storage
    slots, places = np.divmod(records_of(storage.gaussians)[0], 1024)
    blocks = [unpack(storage.blocks.keys[slot]) for slot in slots]
    voxels = [
        tuple(8 * block[axis] + (place >> 3 * axis & 7) for axis in range(3))
        for block, place in zip(blocks, places.tolist(), strict=True)
    ]
    sides = dict(zip(voxels, (places >> 9).tolist(), strict=True))
    often = {voxel for voxel, count in Counter(voxels).items() if count > 1}
    return {voxel: side for voxel, side in sides.items() if voxel not in often}


def assert_same_surface(found: VoxelMap, expected: VoxelMap) -> None:
    one, other = surface(found), surface(expected)
    # Rounding may move a mean across the tolerance of a tenth of a voxel beyond the voxel's face.
    assert len(one.keys() ^ other.keys()) <= 0.002 * len(one)
    assert len(one) > 500
    for index in one.keys() & other.keys():
        scale = np.trace(one[index][1])
        np.testing.assert_allclose(one[index][0], other[index][0], atol=1e-5)
        np.testing.assert_allclose(one[index][1], other[index][1], atol=1e-4 * scale)


def test_any_order_gives_the_same_file(tmp_path) -> None:
    parts = [session(range(4)), session(range(10, 13), offset=1e-5), session(range(20, 24))]
    contents = set()
    for order in permutations(parts):
        merged(*order).save(tmp_path / "map.infomap")
        contents.add((tmp_path / "map.infomap").read_bytes())
    assert len(contents) == 1


def test_the_map_is_that_of_a_session_which_went_on_from_the_file(tmp_path) -> None:
    first, second = session(range(5)), session(range(50, 55))
    first.save(tmp_path / "map.infomap")
    resumed = fuse(VoxelMap.load(tmp_path / "map.infomap"), range(50, 55))
    joined = merged(first, second)
    assert occupancy(joined) == occupancy(resumed)
    assert_same_surface(joined, resumed)


def test_the_map_is_that_of_all_scans() -> None:
    joined = merged(session(range(5)), session(range(50, 55)))
    whole = session([*range(5), *range(50, 55)])
    assert occupancy(joined) == occupancy(whole)
    assert_same_surface(joined, whole)


def stated(rng: np.random.Generator, largest: int) -> VoxelMap:
    """A map with random evidence up to so many quanta, in blocks that are wholly known or not."""
    indices = np.indices((24, 16, 16)).reshape(3, -1).T.astype(np.int32) - 11
    known = rng.random(len(indices)) < 0.7
    quanta = rng.integers(-largest, largest + 1, len(indices)).astype(np.int32)
    nothing = np.zeros((len(indices), 9), np.float32)
    voxel_map = VoxelMap(CONFIG)
    states = VoxelStates(indices, known, np.where(known, quanta, 0).astype(np.int32), nothing)
    put_states(voxel_map._storage, states)
    return voxel_map


def seen_through(times: int, step: float) -> VoxelMap:
    """Blocks that are free as a whole: a distant wall, seen by one who walks to it."""
    voxel_map = VoxelMap(CONFIG)
    for look in range(times):
        pose = np.eye(4)
        pose[2, 3] = step * look
        points = CAMERA.back_project(np.full((48, 64), 2.8 - step * look))
        voxel_map.integrate(points, pose, camera=CAMERA)
    return voxel_map


@pytest.mark.parametrize("largest", [3, 120, 3000])
def test_evidence_of_every_voxel_is_the_sum(rng, largest) -> None:
    parts = [stated(rng, largest), stated(rng, 5), seen_through(5, 0.06), seen_through(3, 0.07)]
    assert (parts[2]._storage.blocks.kind == 1).any()  # UNIFORM
    total: dict[tuple[int, ...], float] = {}
    for part in parts:
        for index, odds in occupancy(part).items():
            total[index] = total.get(index, 0.0) + odds
    # Evidence at random contradicts itself in surfaces, so it is added without a comparison.
    assert occupancy(sum_of_maps(parts)) == total


def test_errors_of_each_map_as_a_whole_weigh_its_points() -> None:
    first, second = session(range(5), offset=1e-5), session(range(50, 55), offset=4e-4)
    joined, one, other = surface(merged(first, second)), surface(first), surface(second)
    sides, known, compared = [*map(seen_from_one_side, (first, second))], occupancy(second), 0
    for index, (mean, covariance) in joined.items():
        if index in one and index not in known:
            expected = one[index]
        elif index in one and index in other and sides[0].get(index, 2) == sides[1].get(index, 3):
            weights = [np.linalg.inv(each[index][1]) for each in (one, other)]
            total = np.linalg.inv(weights[0] + weights[1])
            pull = weights[0] @ one[index][0] + weights[1] @ other[index][0]
            expected = total @ pull, total
            compared += 1
        else:
            continue
        scale = np.trace(covariance)
        np.testing.assert_allclose(mean, expected[0], atol=2e-5)
        np.testing.assert_allclose(covariance, expected[1], atol=2e-4 * scale)
    assert compared > 300
    assert not merged(first, second).offset.any()


def test_an_error_that_the_maps_share_is_kept_once() -> None:
    first, second = session(range(5), 1e-5, origin=7), session(range(50, 55), 1e-5, origin=7)
    both = first.offset
    second._storage.offset = both.copy()
    joined = merged(first, second)
    np.testing.assert_array_equal(joined.offset, both)
    assert joined.origin == 7
    _, means, absolute = joined.gaussians()
    _, _, relative = joined.gaussians(relative=True)
    np.testing.assert_allclose(absolute - relative, point_covariances(both, means), atol=1e-12)
    assert_same_surface(
        joined, _with_offset(merged(session(range(5)), session(range(50, 55))), both)
    )


def _with_offset(voxel_map: VoxelMap, offset: np.ndarray) -> VoxelMap:
    voxel_map._storage.offset = offset
    return voxel_map


def test_a_session_counts_once(tmp_path) -> None:
    first, second = session(range(5)), session(range(50, 55))
    first.save(tmp_path / "map.infomap")
    resumed = fuse(VoxelMap.load(tmp_path / "map.infomap"), range(20, 22))
    interrupted = session(range(2))
    other_settings = fuse(VoxelMap(dataclasses.replace(CONFIG, max_range=2.5)), range(5))
    for again in (first, resumed, interrupted, other_settings, merged(first, second)):
        with pytest.raises(InvalidInputError, match="map 0 and map 1: hold the same session"):
            merged(first, again)
    assert len(merged(second, resumed).sessions) == 3


def test_a_map_of_unknown_sessions_counts_once(tmp_path) -> None:
    first, second = session(range(5)), session(range(50, 55))
    first.sessions = second.sessions = ()
    joined = merged(first, second)
    assert len(joined.sessions) == 2
    joined.save(tmp_path / "map.infomap")
    for again in (first, second):
        with pytest.raises(InvalidInputError, match="the same session"):
            merged(VoxelMap.load(tmp_path / "map.infomap"), again)


def test_a_map_that_was_reset_begins_a_session() -> None:
    first, voxel_map = session(range(5)), session(range(5))
    voxel_map.reset()
    assert voxel_map.sessions == ()
    assert len(merged(first, fuse(voxel_map, range(50, 55))).sessions) == 2


def test_voxels_of_other_sizes_are_refused() -> None:
    coarse = fuse(VoxelMap(dataclasses.replace(CONFIG, voxel_size=0.1)), range(50, 52))
    with pytest.raises(InvalidInputError, match=r"voxels of 0\.06 m and 0\.1 m"):
        merged(session(range(2)), coarse)


def test_maps_of_other_origins_are_refused_unless_they_were_aligned() -> None:
    first, second = session(range(5), origin=7), session(range(50, 55), origin=8)
    with pytest.raises(InvalidInputError, match="other origins, 00000007 and 00000008"):
        merged(first, second)
    assert merged(first, second, has_common_frame=True).origin == 0
    assert merged(first, session(range(50, 55))).origin == 7


def test_maps_that_contradict_each_other_are_refused() -> None:
    def from_elsewhere(shift: float) -> VoxelMap:
        voxel_map = VoxelMap(CONFIG)
        for look in range(4):
            pose = look_at([0.1 * look, 0.2, 0.0], [2.0, 0.4, -0.3])
            points = SCENE.points(CAMERA, pose)
            pose[0, 3] += shift
            voxel_map.integrate(points, pose, camera=CAMERA)
        return voxel_map

    first = session(range(5))
    _, agreement = merge_maps([NamedMap("a", first), NamedMap("b", from_elsewhere(0.0))])
    assert agreement.compared > 1000
    assert agreement.contradicted < 0.05 * agreement.compared
    with pytest.raises(InvalidInputError, match="contradict each other in"):
        merged(first, from_elsewhere(-0.5), has_common_frame=True)


def test_more_than_fits_is_refused() -> None:
    fine = dataclasses.replace(CONFIG, voxel_size=0.03)
    small = VoxelMap(dataclasses.replace(fine, memory_limit=0.001))
    with pytest.raises(CapacityError, match=r"limit of 0\.001 GB"):
        merged(small, fuse(VoxelMap(fine), range(50, 60)))


def test_no_map_is_refused() -> None:
    with pytest.raises(InvalidInputError, match="there is none"):
        merge_maps([])
