"""Checking a scan at the door of the map."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeGuard

import numpy as np
from numpy.typing import ArrayLike, NDArray

from infomap_ros.errors import InvalidInputError
from infomap_ros.geometry import PinholeCamera, check_covariance, check_transform, float_array
from infomap_ros.geometry.transforms import FloatArray

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
        pose_covariance: shape (6, 6); zero where none was given.
        camera: or None for an unorganised cloud.
        outside: points that the camera cannot have seen, beside its image or behind another point.
    """

    points: NDArray[np.float32]
    covariances: NDArray[np.float32]
    columns: Columns
    transform: FloatArray
    pose_covariance: FloatArray
    camera: PinholeCamera | None
    outside: int = 0


def checked_scan(
    points: ArrayLike,
    transform: ArrayLike,
    covariances: ArrayLike | None,
    pose_covariance: ArrayLike | None,
    camera: PinholeCamera | None,
    default_sigma: float,
) -> Scan:
    """Check the arguments of `VoxelMap.integrate` and bring them into one form.

    Raises:
        InvalidInputError: names the argument and what is wrong with it.
    """
    pose = check_transform(transform, "T_map_sensor")
    uncertainty = np.zeros((6, 6))
    if pose_covariance is not None:
        uncertainty = check_covariance(pose_covariance, 6, "pose_covariance")
    cloud = points if _is_float32(points) else float_array(points, "points", np.float32)
    if cloud.ndim not in (2, 3) or cloud.shape[-1] != 3:
        raise InvalidInputError("points", f"shape {cloud.shape}, expected (N, 3) or (H, W, 3)")
    table, columns = _covariance_table(covariances, cloud.shape[:-1], default_sigma)
    cloud = np.ascontiguousarray(cloud)
    if camera is None:
        return Scan(cloud.reshape(-1, 3), table, columns, pose, uncertainty, None)
    size = (camera.height, camera.width)
    if cloud.ndim == 3 and cloud.shape[:2] != size:
        raise InvalidInputError(
            "points",
            f"organised as {cloud.shape[1]}x{cloud.shape[0]}, but the camera has "
            f"{camera.width}x{camera.height} pixels",
        )
    outside = 0
    if cloud.ndim == 2 and len(cloud) != camera.height * camera.width:
        cloud, table, outside = _organise(cloud, table, camera)
    return Scan(cloud.reshape(*size, 3), table, columns, pose, uncertainty, camera, outside)


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


def _organise(
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
    organised = np.full((camera.height * camera.width, 3), np.nan, np.float32)
    organised[place] = points[order]
    if len(table) > 1:
        spread = np.zeros((camera.height * camera.width, table.shape[1]), np.float32)
        spread[place] = table[order]
        table = spread
    used = int(np.count_nonzero(np.isfinite(organised[:, 2])))
    return organised, table, int(np.count_nonzero(finite)) - used
