"""A map that is full stays as it was, and can be used."""

from __future__ import annotations

import numpy as np
import pytest

from infomap_ros.errors import CapacityError
from infomap_ros.geometry import PinholeCamera
from infomap_ros.mapping import VoxelMap, VoxelMapConfig
from infomap_ros.mapping.voxels import storage, surface
from infomap_ros.mapping.voxels.keys import BLOCK_COUNT
from infomap_ros.mapping.voxels.state import VoxelStates, put_states
from infomap_ros.mapping.voxels.surface_kernels import ROW_COUNT

from .scenes import look_at
from .voxels import voxels_of

CAMERA = PinholeCamera(64, 48, 50.0, 50.0, 31.5, 23.5)
WALL = CAMERA.back_project(np.full((48, 64), 1.5))
CONFIG = VoxelMapConfig(voxel_size=0.08)


def half_full() -> VoxelMap:
    voxel_map = VoxelMap(CONFIG)
    voxel_map.integrate(WALL, np.eye(4), camera=CAMERA)
    return voxel_map


@pytest.mark.parametrize(("limit", "place"), [("MAX_BLOCKS", BLOCK_COUNT), ("MAX_ROWS", ROW_COUNT)])
def test_a_scan_beyond_what_can_be_numbered_changes_nothing(monkeypatch, limit, place):
    voxel_map = half_full()
    arrays = voxel_map._storage.blocks if limit == "MAX_BLOCKS" else voxel_map._storage.gaussians
    before = voxels_of(voxel_map)
    monkeypatch.setattr(surface, limit, int(arrays.counts[place]))
    back = look_at(np.zeros(3), np.array([1.0, 0.2, 0.0]))
    with pytest.raises(CapacityError, match="limits"):
        voxel_map.integrate(WALL, back, camera=CAMERA)
    assert voxels_of(voxel_map) == before
    voxel_map.integrate(WALL, np.eye(4), camera=CAMERA)  # nothing new: there is room for it


def test_states_beyond_what_can_be_numbered_change_nothing(monkeypatch):
    voxel_map = half_full()
    before = voxels_of(voxel_map)
    blocks = int(voxel_map._storage.blocks.counts[BLOCK_COUNT])
    monkeypatch.setattr(surface, "MAX_BLOCKS", blocks)
    far = np.array([[900, 900, 900]], np.int32)
    nothing = np.zeros((1, 9), np.float32)
    states = VoxelStates(far, np.ones(1, np.bool_), np.full(1, 5, np.int32), nothing)
    with pytest.raises(CapacityError):
        put_states(voxel_map._storage, states)
    assert voxels_of(voxel_map) == before


def test_a_scan_that_fails_half_way_leaves_nothing_behind_for_the_next(monkeypatch):
    voxel_map = half_full()
    rows = voxel_map._integrator._writer

    def fail(*_: object) -> None:
        raise MemoryError

    monkeypatch.setattr(storage.surface, "with_records", fail)
    with pytest.raises(MemoryError):
        voxel_map.integrate(WALL, np.eye(4), camera=CAMERA)
    assert (rows._hit_row == -1).all()
    monkeypatch.undo()
    voxel_map.integrate(WALL, np.eye(4), camera=CAMERA)
