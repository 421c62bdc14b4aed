"""Checking a scan at the door of the map.

What gathering a scan leaves: its points by voxel, and the voxels that it sees through.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeGuard

import numpy as np
from numpy.typing import ArrayLike, NDArray

from infomap_ros.errors import CapacityError, InvalidInputError
from infomap_ros.geometry import PinholeCamera, PoseUncertainty, check_transform, float_array
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.mapping.config import VoxelMapConfig
from infomap_ros.mapping.scans.scan import ScanRows
from infomap_ros.mapping.voxels.keys import BLOCK_SIDE, COORDINATE_LIMIT
from infomap_ros.mapping.voxels.storage import FreeBlocks

Columns = tuple[int, int, int, int, int, int]

_FULL: Columns = (0, 1, 2, 4, 5, 8)
_UPPER: Columns = (0, 1, 2, 3, 4, 5)


@dataclass(frozen=True, eq=False)
class Scan:
    """A checked scan.

    Attributes:
        points: shape (H, W, 3) with a camera, else (N, 3), float32, sensor frame [m].
        covariances: shape (H * W or N, k), or (1, k) when all points share one [m^2].
        columns: columns of xx, xy, xz, yy, yz, zz in `covariances`.
        transform: T_map_sensor, shape (4, 4).
        pose_covariance: of drift and white noise, shape (6, 6); zero where none was given.
        drift: of the drift, shape (6, 6); likewise.
        clock: of the drift.
        camera: or None for an unorganized cloud.
        outside: points that the camera cannot have seen, beside its image or behind another point.
    """

    points: NDArray[np.float32]
    covariances: NDArray[np.float32]
    columns: Columns
    transform: FloatArray
    pose_covariance: FloatArray
    drift: FloatArray
    clock: float
    camera: PinholeCamera | None
    outside: int = 0


def checked_scan(
    points: ArrayLike,
    transform: ArrayLike,
    covariances: ArrayLike | None,
    uncertainty: PoseUncertainty | None,
    camera: PinholeCamera | None,
    default_sigma: float,
) -> Scan:
    """Check the arguments of `VoxelMap.integrate` and bring them into one form.

    Raises:
        InvalidInputError: names the argument and what is wrong with it.
    """
    pose = check_transform(transform, "T_map_sensor")
    known = uncertainty or PoseUncertainty(np.zeros((6, 6)))
    errors = known.drift + known.white, known.drift, known.clock
    cloud = points if _is_float32(points) else float_array(points, "points", np.float32)
    if cloud.ndim not in (2, 3) or cloud.shape[-1] != 3:
        raise InvalidInputError("points", f"shape {cloud.shape}, expected (N, 3) or (H, W, 3)")
    table, columns = _covariance_table(covariances, cloud.shape[:-1], default_sigma)
    cloud = np.ascontiguousarray(cloud)
    if camera is None:
        return Scan(cloud.reshape(-1, 3), table, columns, pose, *errors, None)
    size = (camera.height, camera.width)
    if cloud.ndim == 3 and cloud.shape[:2] != size:
        raise InvalidInputError(
            "points",
            f"organized as {cloud.shape[1]}x{cloud.shape[0]}, but the camera has "
            f"{camera.width}x{camera.height} pixels",
        )
    outside = 0
    if cloud.ndim == 2 and len(cloud) != camera.height * camera.width:
        cloud, table, outside = _organize(cloud, table, camera)
    return Scan(cloud.reshape(*size, 3), table, columns, pose, *errors, camera, outside)


def check_within_limits(transform: FloatArray, voxel_size: float) -> None:
    """Refuse a scan from beyond the voxels that have an index.

    Raises:
        InvalidInputError: it is.
    """
    away, limit = float(np.abs(transform[:3, 3]).max()), COORDINATE_LIMIT * voxel_size
    if away >= limit:
        raise InvalidInputError(
            "T_map_sensor",
            f"is {away:g} m from the origin; with voxels of {voxel_size:g} m a map ends at "
            f"{limit:g} m",
        )


def checked_rays(
    origins: ArrayLike, directions: ArrayLike, max_range: float, voxel_size: float
) -> tuple[FloatArray, FloatArray]:
    """Check the arguments of `VoxelMap.cast_rays`.

    Returns:
        Origins and unit directions, shape (N, 3) each.

    Raises:
        InvalidInputError: names the argument and what is wrong with it.
    """
    rays, starts = checked_points(directions, "directions"), float_array(origins, "origins")
    if starts.shape not in ((3,), rays.shape):
        raise InvalidInputError("origins", f"shape {starts.shape}, expected {rays.shape}")
    lengths = np.linalg.norm(rays, axis=1, keepdims=True)
    if not (np.isfinite(starts).all() and np.isfinite(rays).all() and (lengths > 0.0).all()):
        raise InvalidInputError("rays", "hold NaN, infinity or a direction of length zero")
    reach = np.abs(starts).max(initial=0.0) + max_range
    if not (max_range > 0.0 and reach / voxel_size < 1e6):
        raise InvalidInputError(
            "max_range", f"is {max_range} m, expected a positive range within the map's limits"
        )
    return np.ascontiguousarray(np.broadcast_to(starts, rays.shape)), rays / lengths


def checked_points(points: ArrayLike, name: str) -> FloatArray:
    """Points as numbers, shape (N, 3).

    Raises:
        InvalidInputError: another shape, or no numbers.
    """
    places = float_array(points, name)
    if places.ndim != 2 or places.shape[1] != 3:
        raise InvalidInputError(name, f"shape {places.shape}, expected (N, 3)")
    return places


def checked_box(box: ArrayLike, name: str) -> FloatArray:
    """A box as (low, high) corners, shape (2, 3).

    Raises:
        InvalidInputError: it is none.
    """
    corners = float_array(box, name)
    is_box = corners.shape == (2, 3) and np.isfinite(corners).all()
    if not is_box or (corners[1] < corners[0]).any():
        raise InvalidInputError(name, f"is {corners.tolist()}, expected (low, high) corners")
    return corners


def _is_float32(values: object) -> TypeGuard[NDArray[np.float32]]:
    """Whether values need no conversion, which for a cloud would cost a copy."""
    return isinstance(values, np.ndarray) and values.dtype == np.float32


def _covariance_table(
    covariances: ArrayLike | None, shape: tuple[int, ...], default_sigma: float
) -> tuple[NDArray[np.float32], Columns]:
    """Covariances as rows, and which of their columns hold the upper triangle."""
    if covariances is None:
        row = np.array([[1, 0, 0, 1, 0, 1]], np.float32) * np.float32(default_sigma**2)
        return row, _UPPER
    array = covariances
    if not _is_float32(array):
        array = float_array(array, "covariances", np.float32)
    if array.shape == (*shape, 3, 3):
        return np.ascontiguousarray(array).reshape(-1, 9), _FULL
    if array.shape == (*shape, 6):
        return np.ascontiguousarray(array).reshape(-1, 6), _UPPER
    raise InvalidInputError(
        "covariances", f"shape {array.shape}, expected {(*shape, 3, 3)} or {(*shape, 6)}"
    )


def _organize(
    points: NDArray[np.float32], table: NDArray[np.float32], camera: PinholeCamera
) -> tuple[NDArray[np.float32], NDArray[np.float32], int]:
    """Sort points into the pixels that see them, the nearest of a pixel first."""
    with np.errstate(invalid="ignore"):
        pixels = np.rint(camera.project(points))
        u, v = pixels[:, 0], pixels[:, 1]
        seen = (u >= 0) & (u < camera.width) & (v >= 0) & (v < camera.height)
    finite = np.isfinite(points).all(axis=1)
    order = np.flatnonzero(seen & finite)
    order = order[np.argsort(-points[order, 2], kind="stable")]
    place = (v[order] * camera.width + u[order]).astype(np.int64)
    organized = np.full((camera.height * camera.width, 3), np.nan, np.float32)
    organized[place] = points[order]
    if len(table) > 1:
        spread = np.zeros((camera.height * camera.width, table.shape[1]), np.float32)
        spread[place] = table[order]
        table = spread
    used = int(np.count_nonzero(np.isfinite(organized[:, 2])))
    return organized, table, int(np.count_nonzero(finite)) - used


FREE_BLOCK_BYTES = 64.0


@dataclass(frozen=True, eq=False)
class GatheredScan:
    """A scan by voxel; valid until the next one is gathered.

    Attributes:
        parts: the points by voxel, in one or more parts that share no voxel with points.
        free: the blocks that the scan sees through.
        see: ``see(first, last)`` finds which voxels of the blocks [first, last) are free.
        unseen: number of blocks for which that remains to be done.
    """

    parts: list[ScanRows]
    free: FreeBlocks
    see: Callable[[int, int], None]
    unseen: int


def check_block_count(count: int, config: VoxelMapConfig) -> None:
    """Refuse a scan that alone would fill the memory limit.

    Raises:
        CapacityError: it would.
    """
    if count * FREE_BLOCK_BYTES > config.memory_limit * 1e9:
        raise CapacityError(
            f"one scan sees through {count} blocks or more of {BLOCK_SIDE}^3 voxels, too many "
            f"for the memory limit of {config.memory_limit:g} GB: reduce max_range or enlarge "
            "voxel_size"
        )
