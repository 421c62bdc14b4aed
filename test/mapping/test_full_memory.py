"""The machine has no memory left in the middle of a scan: the map can be used and saved."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from infomap_ros.errors import CapacityError
from infomap_ros.geometry import make_transform
from infomap_ros.mapping import VoxelMap, VoxelMapConfig
from infomap_ros.mapping.voxels import keys, storage, surface

LOOKING_AHEAD = [[0, 0, 1], [-1, 0, 0], [0, -1, 0]]


def integrate(voxel_map: VoxelMap, number: int) -> None:
    """A wall, each time elsewhere."""
    rng = np.random.default_rng(number)
    points = np.column_stack([rng.uniform(-1.0, 1.0, (3000, 2)), np.full(3000, 2.0)])
    pose = make_transform(LOOKING_AHEAD, (0.0, 3.0 * number, 0.0))
    voxel_map.integrate(points.astype(np.float32), pose, pose_covariance=1e-6 * np.eye(6))


@pytest.mark.parametrize("module", [keys, storage, surface, surface])
def test_no_memory_in_a_scan(module: Any, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Each of the arrays in turn cannot grow."""
    fresh = VoxelMap(VoxelMapConfig(voxel_size=0.05))
    for number in range(3):
        integrate(fresh, number)
    failures = 0
    while fails(module, failures, fresh, monkeypatch, tmp_path / "map.infomap"):
        failures += 1
    assert failures > 0


def fails(
    module: Any, call: int, fresh: VoxelMap, monkeypatch: pytest.MonkeyPatch, path: Path
) -> bool:
    """Whether a scan makes so many arrays grow; if so, what becomes of the map without one."""
    voxel_map = VoxelMap(VoxelMapConfig(voxel_size=0.05))
    integrate(voxel_map, 0)
    calls, grown = iter(range(1000)), module.grown

    def full(*arguments: Any, **options: Any) -> Any:
        if next(calls) == call:
            raise MemoryError
        return grown(*arguments, **options)

    with monkeypatch.context() as patch:
        patch.setattr(module, "grown", full)
        try:
            integrate(voxel_map, 1)
        except CapacityError as error:
            assert "no memory" in str(error)
        else:
            return False
    voxel_map.save(path)
    loaded = VoxelMap.load(path)
    for each in (voxel_map, loaded):
        integrate(each, 1)
        integrate(each, 2)
        assert each.known_voxels == fresh.known_voxels
        assert np.isfinite(each.gaussians()[1]).all()
    return True
