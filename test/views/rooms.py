"""Maps of rooms seen from known places."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from infomap_ros.geometry import PinholeCamera, make_transform
from infomap_ros.mapping import VoxelMap, VoxelMapConfig

CAMERA = PinholeCamera(width=80, height=60, fx=50.0, fy=50.0, cx=39.5, cy=29.5)


def facing(azimuth: float, position: Sequence[float], elevation: float = 0.0) -> np.ndarray:
    """T_map_camera of a level optical frame at `position`, azimuth from x [rad]."""
    sin_a, cos_a = np.sin(azimuth), np.cos(azimuth)
    sin_e, cos_e = np.sin(elevation), np.cos(elevation)
    rotation = np.array(
        [
            [sin_a, cos_a * sin_e, cos_a * cos_e],
            [-cos_a, sin_a * sin_e, sin_a * cos_e],
            [0.0, -cos_e, sin_e],
        ]
    )
    return make_transform(rotation, position)


def box_points(
    camera: PinholeCamera,
    T_map_camera: np.ndarray,
    room: Sequence[float],
    blocks: Sequence[Sequence[float]] = (),
) -> np.ndarray:
    """What the camera measures in a room from (0, 0, 0) to `room` [m] with blocks in it.

    Blocks are (x, y, z) of the low corner, then of the high one.
    """
    rays = camera.back_project(np.ones((camera.height, camera.width))).astype(np.float64)
    directions = rays @ T_map_camera[:3, :3].T
    origin = T_map_camera[:3, 3]
    with np.errstate(divide="ignore", invalid="ignore"):
        walls = np.where(directions > 0.0, (np.array(room) - origin), -origin) / directions
        depth = np.nanmin(np.where(np.abs(directions) > 1e-12, walls, np.inf), axis=-1)
        for block in blocks:
            sides = (np.array(block).reshape(2, 3)[:, None, None] - origin) / directions
            near, far = sides.min(axis=0).max(axis=-1), sides.max(axis=0).min(axis=-1)
            hit = (near <= far) & (near > 0.0)
            depth = np.where(hit & (near < depth), near, depth)
    return (rays * depth[..., None]).astype(np.float32)


def seen_room(
    poses: Sequence[np.ndarray],
    room: Sequence[float] = (6.0, 4.0, 2.5),
    blocks: Sequence[Sequence[float]] = (),
    voxel_size: float = 0.1,
    camera: PinholeCamera = CAMERA,
) -> VoxelMap:
    """Map of a room after two scans from each pose: what two scans see through is free."""
    voxel_map = VoxelMap(VoxelMapConfig(voxel_size=voxel_size, max_range=5.0))
    for pose in poses:
        points = box_points(camera, pose, room, blocks)
        for _ in range(2):
            voxel_map.integrate(points, pose, camera=camera)
    return voxel_map


def turning(position: Sequence[float], count: int = 6) -> list[np.ndarray]:
    """Level poses all around a place."""
    return [facing(2.0 * np.pi * i / count, position) for i in range(count)]
