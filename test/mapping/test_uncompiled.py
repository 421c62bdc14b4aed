"""The kernels mean the same as plain Python: a small map, compiled and not."""

from __future__ import annotations

import os
import subprocess
import sys

import numpy as np

from infomap_ros.geometry import PinholeCamera
from infomap_ros.mapping import VoxelMap, VoxelMapConfig

from .scenes import Scene, look_at

SCRIPT = """
import sys
import numpy as np
from numba import config
from infomap_ros.geometry import PinholeCamera
from infomap_ros.mapping import VoxelMap, VoxelMapConfig

assert config.DISABLE_JIT
scans = np.load(sys.argv[1])
camera = PinholeCamera(*scans["size"].tolist(), *scans["intrinsics"].tolist())
voxel_map = VoxelMap(VoxelMapConfig(voxel_size=0.3, max_range=2.4, default_sigma=0.02))
voxel_map.track_changes(True)
for number, (points, pose) in enumerate(zip(scans["points"], scans["poses"])):
    voxel_map.integrate(points, pose, None, np.eye(6) * 1e-5, camera if number else None)
indices, log_odds = voxel_map.voxels()
surface, means, covariances = voxel_map.gaussians()
distances, hits = voxel_map.cast_rays([0.0, 0.0, 0.0], np.eye(3), 3.0)
voxel_map.save(sys.argv[2])
VoxelMap.load(sys.argv[2])
np.savez(
    sys.argv[3], indices=indices, log_odds=log_odds, surface=surface, means=means,
    covariances=covariances, distances=distances, entropy=voxel_map.entropy_bits(),
    changes=voxel_map.take_changes().indices,
)
"""


def test_kernels_do_the_same_uncompiled(tmp_path):
    camera = PinholeCamera(20, 14, 15.0, 15.0, 9.5, 6.5)
    walls = [(*np.eye(3)[axis] * sign, 1.7) for axis in range(3) for sign in (-1.0, 1.0)]
    scene = Scene(planes=walls, spheres=[(0.8, 0.3, 0.0, 0.3)])
    poses = [look_at(np.array([-0.4, y, 0.1]), np.array([0.9, -y, 0.0])) for y in (-0.3, 0.2, 0.5)]
    points = np.array([scene.points(camera, pose) for pose in poses])
    points[1, 3:6, 4:9] = np.nan
    scans = tmp_path / "scans.npz"
    np.savez(
        scans,
        points=points,
        poses=poses,
        size=[camera.width, camera.height],
        intrinsics=[camera.fx, camera.fy, camera.cx, camera.cy],
    )
    found = tmp_path / "found.npz"
    subprocess.run(
        [sys.executable, "-W", "ignore", "-c", SCRIPT, scans, tmp_path / "a.map", found],
        env={**os.environ, "NUMBA_DISABLE_JIT": "1"},
        check=True,
        timeout=120,
    )
    voxel_map = VoxelMap(VoxelMapConfig(voxel_size=0.3, max_range=2.4, default_sigma=0.02))
    voxel_map.track_changes(True)
    for number, (cloud, pose) in enumerate(zip(points, poses, strict=True)):
        voxel_map.integrate(cloud, pose, None, np.eye(6) * 1e-5, camera if number else None)
    uncompiled = np.load(found)
    indices, log_odds = voxel_map.voxels()
    np.testing.assert_array_equal(uncompiled["indices"], indices)
    # Plain Python keeps single precision where compiled code does not: a few voxels round off.
    assert (uncompiled["log_odds"] == log_odds).mean() > 0.99
    assert (log_odds > 0.0).sum() > 50 and (log_odds < 0.0).sum() > 50
    surface, means, covariances = voxel_map.gaussians()
    np.testing.assert_array_equal(uncompiled["surface"], surface)
    same = np.isclose(uncompiled["means"], means, atol=1e-5).all(axis=1)
    same &= np.isclose(uncompiled["covariances"], covariances, 1e-2, 1e-7).all(axis=(1, 2))
    assert same.mean() > 0.95
    distances, _ = voxel_map.cast_rays([0.0, 0.0, 0.0], np.eye(3), 3.0)
    np.testing.assert_allclose(uncompiled["distances"], distances, atol=1e-5)
    np.testing.assert_allclose(uncompiled["entropy"], voxel_map.entropy_bits(), rtol=1e-2)
    np.testing.assert_array_equal(uncompiled["changes"], voxel_map.take_changes().indices)
