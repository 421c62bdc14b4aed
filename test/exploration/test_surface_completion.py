"""Holes in a floor: where they are found, and what views are expected to show of them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from infomap_ros.exploration.view_choice import SurfaceCompletion, missing_surface
from infomap_ros.geometry import PinholeCamera
from infomap_ros.mapping import VoxelMap
from infomap_ros.mapping.voxels.keys import pack
from infomap_ros.mapping.voxels.state import (
    VoxelStates,
    information_of,
    put_states,
    unknown_states,
)
from infomap_ros.views.decision import UnproductiveLooks
from infomap_ros.views.information.view_query import InformationConfig, checked_poses
from infomap_ros.views.sampling.orientations import look_rotations
from infomap_ros.views.situation import RegionOfTask, Situation

REGION = np.array([(-1.2, -1.2, -0.3), (1.2, 1.2, 1.0)])
INSIDE = (0.0, 0.0, 0.5)
HOLE = np.indices((6, 6, 1), np.int32).reshape(3, -1).T + np.int32((6, -3, -1))
CAMERA = PinholeCamera(160, 120, 110.0, 110.0, 79.5, 59.5)


@pytest.fixture
def floor() -> VoxelMap:
    """Even ground in the voxels below z = 0, known with the air above it."""
    indices = np.indices((60, 60, 27), np.int32).reshape(3, -1).T + np.int32((-30, -30, -1))
    voxel_map = VoxelMap()
    put_voxels(voxel_map, indices, indices[:, 2] < 0)
    return voxel_map


def put_voxels(voxel_map: VoxelMap, indices: np.ndarray, is_surface: np.ndarray) -> None:
    """Surface in the middle of some voxels, with normals along z; the others are free."""
    size = voxel_map.config.voxel_size
    covariances = np.tile(np.diag((0.02, 0.02, 0.001)) ** 2, (len(indices), 1, 1))
    gaussians = information_of(indices, is_surface, (indices + 0.5) * size, covariances, size)
    quanta = np.where(is_surface, 20, -20).astype(np.int32)
    known = np.ones(len(indices), bool)
    put_states(voxel_map._storage, VoxelStates(indices, known, quanta, gaussians))


def with_hole(voxel_map: VoxelMap) -> VoxelMap:
    put_states(voxel_map._storage, unknown_states(HOLE))
    return voxel_map


def view_from(position: tuple[float, float, float], at: tuple[float, float, float]) -> np.ndarray:
    direction = np.subtract(at, position)
    pose = np.eye(4)
    azimuth, elevation = (
        np.arctan2(direction[1], direction[0]),
        np.arctan2(direction[2], np.hypot(*direction[:2])),
    )
    pose[:3, :3] = look_rotations(np.array([azimuth]), np.array([elevation]))[0]
    pose[:3, 3] = position
    return checked_poses(pose)[0]


def situation_of(voxel_map: VoxelMap, pose: np.ndarray) -> Situation:
    return Situation(voxel_map, CAMERA, 3.0, pose, region=RegionOfTask(*map(tuple, REGION)))


def prepared(voxel_map: VoxelMap, hiding: float = 0.5) -> tuple[SurfaceCompletion, Situation]:
    """With the camera turned away from the hole."""
    completion = SurfaceCompletion(InformationConfig(hiding_probability=hiding))
    situation = situation_of(voxel_map, view_from((-0.5, 0.0, 0.6), (-1.5, 0.0, 0.3)))
    completion.prepare(situation)
    return completion, situation


def test_whole_floor_lacks_nothing(floor):
    assert len(missing_surface(floor, REGION, INSIDE)[0]) == 0


def test_hole_is_found_voxel_by_voxel(floor):
    voxels, normals = missing_surface(with_hole(floor), REGION, INSIDE)
    np.testing.assert_array_equal(voxels, HOLE)
    np.testing.assert_allclose(normals[:, 2].min(), normals.max(), atol=0.5)


def test_view_from_above_shows_the_hole_and_others_do_not(floor):
    completion, situation = prepared(with_hole(floor))
    views = np.stack(
        [
            view_from((0.0, 0.0, 0.6), (0.4, 0.0, 0.0)),
            view_from((0.0, 0.0, 0.6), (-0.4, 0.0, 0.0)),  # it is behind
        ]
    )
    shown = completion.exact(situation, views)
    assert 1.0 < shown[0] < len(HOLE)
    np.testing.assert_array_equal(shown[1:], 0.0)


def test_a_wall_hides_the_hole(floor):
    with_hole(floor)
    wall = np.indices((1, 60, 14), np.int32).reshape(3, -1).T + np.int32((2, -30, 0))
    put_voxels(floor, wall, np.ones(len(wall), bool))
    completion, situation = prepared(floor)
    view = view_from((-0.3, 0.0, 0.6), (0.4, 0.0, 0.0))
    gains = completion.gains(situation, view[None])[0]
    assert not np.isin(gains.keys, keys_of(HOLE)).any()


@pytest.mark.parametrize(("evidence", "shows"), [(8, True), (9, False)])
def test_what_is_less_than_a_hit_hides_nothing_where_a_hit_is_asked_for(floor, evidence, shows):
    """A layer of evidence in the air above the hole, of 2.0 or 2.25 nats; 0.9 is 2.2 nats."""
    completion, situation = prepared(with_hole(floor), hiding=0.9)
    view = view_from((0.4, 0.0, 0.8), (0.45, 0.0, 0.0))
    before = completion.exact(situation, view[None])
    places = np.indices((20, 20, 1), np.int32).reshape(3, -1).T + np.int32((0, -10, 6))
    layer = unknown_states(places)
    layer.known[:], layer.quanta[:] = True, evidence
    put_states(floor._storage, layer)
    assert before[0] > 1.0
    shown = completion.exact(situation, view[None]) / before
    assert shown == pytest.approx(1.0) if shows else shown < 0.2


def keys_of(voxels: np.ndarray) -> np.ndarray:
    return np.array([pack(*map(int, voxel)) for voxel in voxels])


def test_views_count_the_voxels_that_they_show(floor):
    rng = np.random.default_rng(5)
    completion, situation = prepared(with_hole(floor))
    at = np.column_stack([rng.uniform(-0.5, 1.0, (20, 2)), rng.uniform(0.3, 1.0, 20)])
    views = np.stack([view_from(tuple(p), (0.3, 0.1, 0.0)) for p in at])
    shown = completion.exact(situation, views)
    quick = completion.quick(situation, views[:, :3, 3], views[:, None, :3, :3])[:, 0]
    sums = np.array([gains.total for gains in completion.gains(situation, views)])
    seen = shown > 5.0
    assert seen.sum() > 5 and shown.max() < 1.1 * len(HOLE)
    np.testing.assert_allclose(sums[seen] / shown[seen], sums[seen][0] / shown[seen][0], rtol=0.05)
    np.testing.assert_allclose(quick, shown, atol=0.35 * len(HOLE))


def test_proposed_views_show_the_hole(floor):
    completion, situation = prepared(with_hole(floor))

    class Everywhere:
        def in_box(self, points):
            return points, np.ones(len(points), bool)

    views = completion.propose(situation, Everywhere(), np.random.default_rng(1))
    assert (completion.exact(situation, views) > 0.0).mean() > 0.8


def test_what_was_looked_at_in_vain_is_not_sought(floor):
    """By the same count of looks that takes voxels from the information of views."""
    completion, situation = prepared(with_hole(floor))
    looks = UnproductiveLooks(0.5)
    looks.note(np.sort(keys_of(HOLE)), floor, np.array((0.3, 0.0, 0.6)), 3.0)
    promising = looks.without_them(floor)
    assert completion.prepare(replace(situation, promising=promising)) == 0
    assert completion.prepare(situation) > 0
