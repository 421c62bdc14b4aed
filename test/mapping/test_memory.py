"""What a map of a room takes of memory."""

from __future__ import annotations

import numpy as np
import pytest

from infomap_ros.geometry import PinholeCamera
from infomap_ros.mapping import VoxelMap, VoxelMapConfig
from infomap_ros.mapping.voxels.keys import BLOCK_COUNT, block_bytes
from infomap_ros.mapping.voxels.surface import surface_bytes

from .scenes import Scene, look_at

CAMERA = PinholeCamera(320, 240, 262.0, 262.0, 159.5, 119.5)
POSE_COVARIANCE = np.diag([1e-4, 1e-4, 1e-4, 1e-5, 1e-5, 1e-5])
ROOM = Scene(
    [(1, 0, 0, 4), (-1, 0, 0, 4), (0, 1, 0, 4), (0, -1, 0, 4), (0, 0, -1, 1), (0, 0, 1, 2)]
)


def stereo_covariances(points: np.ndarray) -> np.ndarray:
    """Covariances of a pair 10 cm apart, 0.2 px of disparity and 0.3 px in the image [m^2]."""
    z = points[..., 2].astype(float)
    along, across = 0.2 * z**2 / (CAMERA.fx * 0.1), 0.3 * z / CAMERA.fx
    rays = points / points[..., 2:3]
    outer = rays[..., :, None] * rays[..., None, :] * (along**2)[..., None, None]
    return (outer + (across**2)[..., None, None] * np.eye(3)).astype(np.float32)


@pytest.mark.parametrize(("size", "occupancy"), [(0.05, 3.0), (0.02, 2.0)])
def test_a_room_takes_few_bytes_per_voxel(size, occupancy):
    voxel_map = VoxelMap(VoxelMapConfig(voxel_size=size, max_range=5.0))
    for angle in np.arange(12) * np.pi / 6.0:
        pose = look_at(np.zeros(3), np.array([np.cos(angle), np.sin(angle), -0.2]))
        points = ROOM.points(CAMERA, pose)
        voxel_map.integrate(points, pose, stereo_covariances(points), POSE_COVARIANCE, CAMERA)

    storage = voxel_map._storage
    blocks = int(storage.blocks.counts[BLOCK_COUNT])
    assert block_bytes(storage.blocks) <= occupancy * voxel_map.known_voxels
    estimates = len(voxel_map.state()["gaussian_owner"])
    assert surface_bytes(storage.gaussians, blocks) <= 66.0 * estimates
