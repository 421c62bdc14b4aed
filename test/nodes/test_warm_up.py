"""Nothing is compiled, and no kernel is loaded, after the nodes have warmed up."""

from __future__ import annotations

import subprocess
import sys

import pytest

KERNELS = """
import sys
import numpy as np
from numba.core.dispatcher import Dispatcher

def kernels():
    modules = [module for name, module in sys.modules.items() if name.startswith("infomap_ros")]
    found = [v for module in modules for v in vars(module).values() if isinstance(v, Dispatcher)]
    return {(f.py_func.__module__, f.py_func.__name__, str(s)) for f in found for s in f.signatures}
"""

MAP_FUSION = """
from infomap_ros.geometry import PinholeCamera, PlacedSolid, PointCloudRecord, PoseRecord, Sphere
from infomap_ros.mapping import VoxelMap, VoxelMapConfig
from infomap_ros.mapping.files.export import ProjectionConfig, project_map
from infomap_ros.nodes.fusion.map_outputs import voxel_map_rows
from infomap_ros.nodes.fusion.map_keeper import warm_up
from infomap_ros.nodes.common.message_types import RclpyMessageTypes
from infomap_ros.pipeline.map_builder import MapBuilder
from infomap_ros.pipeline.scan_synchronizer import Scan
from infomap_ros.messages import decode_point_cloud, encode_point_cloud
from infomap_ros.team.replica import MapReplica
from infomap_ros.team.update import MapUpdate
from infomap_ros.team.wire import decode_update, encode_update

warm_up(1)
before = kernels()
camera = PinholeCamera(320, 240, 300.0, 300.0, 159.5, 119.5)
voxel_map = VoxelMap(VoxelMapConfig(voxel_size=0.05))
voxel_map.track_changes(True)
replica = MapReplica(voxel_map.config)
for step in range(3):
    points = camera.back_project(np.full((240, 320), 2.0 + 0.7 * step))
    covariances = np.broadcast_to(np.float32(1e-4) * np.eye(3, dtype=np.float32), (240, 320, 3, 3))
    record = PointCloudRecord(0, "camera", points, covariances, np.zeros(points.shape, np.uint8))
    cloud = decode_point_cloud(encode_point_cloud(RclpyMessageTypes(), record))
    pose = np.eye(4)
    pose[0, 3] = step
    where = PoseRecord(0, "map", pose, 1e-6 * np.eye(6))
    MapBuilder(voxel_map).fuse(Scan(cloud, where, [PlacedSolid(Sphere(0.1), np.eye(4))]))
    voxel_map.mark_changed(0, 5)
    parts = encode_update(MapUpdate.of_changes(voxel_map.take_changes(), 0.05, 1, step + 1))
    for part in parts:
        replica.apply(decode_update(part))
    voxel_map_rows(voxel_map)
    project_map(voxel_map, ProjectionConfig())
    voxel_map.known_voxels, voxel_map.is_known(np.zeros((1, 3)))
"""

STEREO_RANGE = """
from infomap_ros.geometry import CameraCalibration, CameraInfoRecord, ImageRecord
from infomap_ros.pipeline.image_synchronizer import ImageSet
from infomap_ros.pipeline.range_estimator import StereoRangeEstimator
from infomap_ros.stereo import StereoConfig

estimator = StereoRangeEstimator(StereoConfig(), rectify=True)
estimator.warm_up()
before = kernels()
K = np.array([[300.0, 0, 160], [0, 300.0, 120], [0, 0, 1]])
for encoding, channels in (("mono8", ()), ("rgb8", (3,))):
    noise = np.random.default_rng(0).integers(0, 256, (240, 328, *channels), dtype=np.uint8)
    images, infos = [], []
    for offset, pixels in ((0.0, noise[:, 8:]), (0.1, noise[:, :320])):
        p = np.hstack([K, [[-300.0 * offset], [0], [0]]])
        distortion = np.array([0.01, 0.0, 0.0, 0.0, 0.0])
        calibration = CameraCalibration(320, 240, "plumb_bob", distortion, K, np.eye(3), p)
        infos.append(CameraInfoRecord(0, "camera", calibration))
        images.append(ImageRecord(0, "camera", np.ascontiguousarray(pixels), encoding))
    estimator.measure(ImageSet(tuple(images), tuple(infos)))
"""


@pytest.mark.parametrize("program", [MAP_FUSION, STEREO_RANGE], ids=["map_fusion", "stereo_range"])
def test_no_kernel_is_new_after_the_warm_up(program: str) -> None:
    script = KERNELS + program + "print(*sorted(kernels() - before), sep='\\n')"

    done = subprocess.run([sys.executable, "-c", script], text=True, capture_output=True)

    assert done.returncode == 0, done.stderr
    assert done.stdout.strip() == ""
