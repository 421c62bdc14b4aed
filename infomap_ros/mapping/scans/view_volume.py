"""Which blocks of a map a scan can have touched: never too few.

A scan informs voxels in its view frustum up to its farthest point or the map's range, and those
within the association distance of them. Blocks and that distance are taken as balls.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from infomap_ros.geometry import PinholeCamera, invert_transform
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.mapping.config import VoxelMapConfig
from infomap_ros.mapping.scans.association import rotated
from infomap_ros.mapping.voxels.keys import BLOCK_SIDE, unpack

_HALF_DIAGONAL = 0.8660254037844386
_SPARE_VOXELS = 2.0
_SPARE_PIXELS = 1.0


class ViewVolume(NamedTuple):
    """Where a scan may have informed the map.

    Attributes:
        inverse_rotation: R of T_sensor_map, row by row.
        position: sensor in the map [m].
        planes: inward unit normals of the frustum's sides, sensor frame, shape (4 or 0, 3).
        reach: largest distance from the sensor [m].
        edge: of a block [m].
    """

    inverse_rotation: tuple[float, ...]
    position: tuple[float, ...]
    planes: FloatArray
    reach: float
    edge: float


def view_volume(
    T_map_sensor: FloatArray,
    camera: PinholeCamera | None,
    farthest: float,
    config: VoxelMapConfig,
) -> ViewVolume:
    """The volume in which a scan may have informed a map.

    Args:
        T_map_sensor: pose of the sensor, shape (4, 4).
        camera: of an organized scan, None for a cloud, which may look everywhere.
        farthest: distance of the farthest point [m].
        config: of the map.
    """
    edge = BLOCK_SIDE * config.voxel_size
    spare = (config.association_limit + _SPARE_VOXELS) * config.voxel_size
    return ViewVolume(
        tuple(invert_transform(T_map_sensor)[:3, :3].ravel().tolist()),
        tuple(T_map_sensor[:3, 3].tolist()),
        np.zeros((0, 3)) if camera is None else _side_planes(camera),
        min(farthest, config.max_range) + spare + _HALF_DIAGONAL * edge,
        edge,
    )


def _side_planes(camera: PinholeCamera) -> FloatArray:
    """Inward unit normals of the sides of a camera's frustum, optical frame, shape (4, 3)."""
    margin = 0.5 + _SPARE_PIXELS
    planes = np.array(
        [
            [camera.fx, 0.0, camera.cx + margin],
            [-camera.fx, 0.0, camera.width - 1.0 + margin - camera.cx],
            [0.0, camera.fy, camera.cy + margin],
            [0.0, -camera.fy, camera.height - 1.0 + margin - camera.cy],
        ]
    )
    return np.asarray(planes / np.linalg.norm(planes, axis=1, keepdims=True))


def mark_blocks(view: ViewVolume, config: VoxelMapConfig, keys: Any, marks: Any) -> None:
    """Mark the blocks that a view may have touched.

    Args:
        view: the volume.
        config: of the map.
        keys: of the blocks, shape (n,), int64.
        marks: receives True for each block in the volume, shape (n,), bool.
    """
    spare = (config.association_limit + _SPARE_VOXELS) * config.voxel_size
    _mark(view, spare + _HALF_DIAGONAL * view.edge, keys, marks)


def touches_any(view: ViewVolume, config: VoxelMapConfig, keys: NDArray[np.int64]) -> bool:
    """Whether a view may have touched one of some blocks, shape (n,)."""
    marks = np.zeros(len(keys), np.bool_)
    mark_blocks(view, config, keys, marks)
    return bool(marks.any())


@njit(cache=True, nogil=True)
def _mark(view: Any, radius: float, keys: Any, marks: Any) -> None:
    """Mark the blocks whose ball of this radius [m] meets the frustum within the reach."""
    planes, t = view.planes, view.position
    for slot in range(len(keys)):
        if marks[slot]:
            continue
        bx, by, bz = unpack(keys[slot])
        dx = (bx + 0.5) * view.edge - t[0]
        dy = (by + 0.5) * view.edge - t[1]
        dz = (bz + 0.5) * view.edge - t[2]
        if dx * dx + dy * dy + dz * dz > view.reach * view.reach:
            continue
        x, y, z = rotated(view.inverse_rotation, dx, dy, dz)
        inside = True
        for side in range(len(planes)):
            distance = planes[side, 0] * x + planes[side, 1] * y + planes[side, 2] * z
            inside &= distance >= -radius
        marks[slot] |= inside
