"""Kernels of a map that are ready before the first message."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from infomap_ros.geometry import PinholeCamera, PlacedSolid, PointCloudRecord, PoseRecord, Sphere
from infomap_ros.geometry.organized import fit_pinhole_camera
from infomap_ros.mapping import VoxelMap, VoxelMapConfig
from infomap_ros.mapping.correction.correctable_map import CorrectableMap
from infomap_ros.mapping.files.projection import ProjectionConfig, project_map
from infomap_ros.messages import decode_point_cloud, encode_point_cloud
from infomap_ros.nodes.common.message_types import RclpyMessageTypes
from infomap_ros.nodes.fusion.map_contents import voxel_map_rows
from infomap_ros.pipeline.map_builder import MapBuilder
from infomap_ros.pipeline.scan_synchronizer import Scan
from infomap_ros.stereo import DepthCameraSensor
from infomap_ros.team.replica import MapReplica
from infomap_ros.team.update import MapUpdate
from infomap_ros.team.wire import encode_update


def warm_up(threads: int) -> None:
    """Use every kernel of a map once, so that it is compiled before the first message.

    Args:
        threads: that integrate a scan.
    """
    points = PinholeCamera(32, 24, 30.0, 30.0, 15.5, 11.5).back_project(np.full((24, 32), 1.0))
    covariances = np.broadcast_to(np.float32(1e-4) * np.eye(3, dtype=np.float32), (24, 32, 3, 3))
    colors = np.zeros(points.shape, np.uint8)
    record = PointCloudRecord(0, "warm_up", points, covariances, colors)
    cloud = decode_point_cloud(encode_point_cloud(RclpyMessageTypes(), record))
    # Voxels so small that all tables grow.
    trial = VoxelMap(VoxelMapConfig(voxel_size=0.01, max_range=2.0, threads=threads))
    trial.track_changes(True)
    pose = PoseRecord(0, "map", np.eye(4), 1e-6 * np.eye(6))
    MapBuilder(trial).fuse(Scan(cloud, pose, [PlacedSolid(Sphere(0.1), np.eye(4))]))
    trial.integrate(cloud.points.reshape(-1, 3)[::16], np.eye(4))
    replica, changes = MapReplica(trial.config), trial.take_changes()
    for version in (1, 2):
        update = MapUpdate.of_changes(changes, 0.01, 0, version)
        encode_update(update)
        replica.apply(update)
    trial.mark_changed(0, 1)
    trial.is_known(np.zeros((trial.known_voxels, 3)))
    voxel_map_rows(trial)
    _warm_up_corrections(trial.config, cloud.points)
    project_map(trial, ProjectionConfig())


def _warm_up_corrections(config: VoxelMapConfig, points: NDArray[np.float32]) -> None:
    """Keep scans in both forms and move them."""
    correctable, elsewhere = CorrectableMap(VoxelMap(config)), np.eye(4)
    correctable.voxel_map.track_changes(True)
    elsewhere[0, 3] = 0.1
    camera = fit_pinhole_camera(points)
    measured = DepthCameraSensor(camera).measure(points[..., 2]) if camera else None
    if measured is not None:
        cloud = measured.organized_points
        correctable.integrate(0, cloud, np.eye(4), measured.covariance_triangles, None, camera)
    correctable.integrate(1, points.reshape(-1, 3), np.eye(4))
    for stamp, pose in enumerate((np.eye(4), elsewhere)):
        correctable.hear(stamp + 2, [0, 1], [pose, pose])
    correctable.correct()
