"""The kernels of the information of views mean the same as plain Python."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np

from infomap_ros.geometry import PinholeCamera
from infomap_ros.mapping import VoxelMap, VoxelMapConfig
from infomap_ros.studies.published_metrics import EVERY_METRIC
from infomap_ros.views.information.view_information import expected_information, view_gains
from infomap_ros.views.information.view_query import InformationConfig

from .rooms import CAMERA, box_points, facing

SCRIPT = """
import sys
import numpy as np
from numba import config
from infomap_ros.geometry import PinholeCamera
from infomap_ros.mapping import VoxelMap
from infomap_ros.views.information.view_information import expected_information
from infomap_ros.views.information.view_query import InformationConfig
from infomap_ros.views.information.view_information import view_gains
from infomap_ros.studies.published_metrics import EVERY_METRIC

assert config.DISABLE_JIT
m, poses = VoxelMap.load(sys.argv[1]), np.load(sys.argv[2])
camera = PinholeCamera(8, 6, 6.0, 6.0, 3.5, 2.5)
settings = InformationConfig(0.3, 0.4, wanted_sigma=0.002, predict_unknown=True)
figures = {
    name: expected_information(m, poses, camera, 2.0, metric, settings)
    for name, metric in EVERY_METRIC.items()
}
gains = view_gains(m, poses[0], camera, 0.8, InformationConfig(0.2))
np.savez(sys.argv[3], keys=gains.keys, gains=gains.gains, **figures)
"""


def test_kernels_do_the_same_uncompiled(tmp_path: Path) -> None:
    m = _small_room()
    poses = facing(0.3, (1.1, 1.0, 0.7), -0.1)[None]
    m.save(tmp_path / "map")
    np.save(tmp_path / "poses.npy", poses)
    paths = [str(tmp_path / name) for name in ("map", "poses.npy", "out.npz")]
    plain = {**os.environ, "NUMBA_DISABLE_JIT": "1"}
    subprocess.run([sys.executable, "-c", SCRIPT, *paths], check=True, env=plain, timeout=120)
    out = np.load(paths[2])
    camera = PinholeCamera(8, 6, 6.0, 6.0, 3.5, 2.5)
    settings = InformationConfig(0.3, 0.4, wanted_sigma=0.002, predict_unknown=True)
    for name, metric in EVERY_METRIC.items():
        value = expected_information(m, poses, camera, 2.0, metric, settings)
        np.testing.assert_allclose(out[name], value, rtol=1e-6, err_msg=name)
    gains = view_gains(m, poses[0], camera, 0.8, InformationConfig(0.2))
    np.testing.assert_array_equal(out["keys"], gains.keys)
    np.testing.assert_allclose(out["gains"], gains.gains, rtol=1e-6)


def _small_room() -> VoxelMap:
    """A small room seen once."""
    m = VoxelMap(VoxelMapConfig(voxel_size=0.2))
    pose = facing(0.0, (0.7, 1.0, 0.7))
    m.integrate(box_points(CAMERA, pose, (3.0, 2.0, 1.5)), pose, camera=CAMERA)
    return m
