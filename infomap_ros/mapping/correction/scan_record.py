"""Scans in the form in which they are kept: small, and always the same when they are taken out.

A scan of a pinhole camera whose covariances are those of range noise along the ray and pixel noise
across it (`infomap_ros.stereo.assembly`) is kept as a coded depth image. Any other scan, an
unorganized cloud or one with other covariances, is kept as it is, compressed.
"""

from __future__ import annotations

import zlib
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from infomap_ros.geometry import PinholeCamera, float_array
from infomap_ros.geometry.kernel import kernel
from infomap_ros.mapping.correction.scan_codec import CodedDepth, code_depth
from infomap_ros.stereo.assembly import assemble
from infomap_ros.stereo.bands import RowBands

_TOLERANCE = 0.02
_SAMPLES_PER_SIDE = 48
_BYTES_OF_OBJECTS = 1000  # about what the Python objects of a record need
_COMPRESSION = 1


@dataclass(frozen=True, eq=False)
class RangeScan:
    """What a sensor measured, in its own frame: the arguments of `VoxelMap.integrate`.

    Attributes:
        points: shape (N, 3), or organized (H, W, 3), float32 [m]; NaN = no measurement.
        covariances: shape (..., 3, 3) or (..., 6), float32 [m^2]; None for the map's default.
        camera: whose pixels the points are, or None.
        error_correlation: of neighboring points, or None for the map's own.
    """

    points: NDArray[np.float32]
    covariances: NDArray[np.float32] | None = None
    camera: PinholeCamera | None = None
    error_correlation: float | None = None


@dataclass(frozen=True, eq=False)
class ScanRecord:
    """A scan that is kept.

    Attributes:
        camera: whose pixels the points are, or None.
        error_correlation: of neighboring points, or None for the map's own.
        farthest: distance of the farthest point [m], 0 where there is none.
    """

    camera: PinholeCamera | None
    error_correlation: float | None
    farthest: float
    _coded: CodedDepth | None
    _pixel_sigma: float
    _arrays: tuple[tuple[tuple[int, ...], bytes], ...]

    def memory_bytes(self) -> int:
        """Memory in use [bytes]."""
        coded = self._coded.memory_bytes() if self._coded else 0
        return _BYTES_OF_OBJECTS + coded + sum(len(data) for _, data in self._arrays)

    def restore(self) -> RangeScan:
        """The scan; the same numbers at each call."""
        if self._coded is None or self.camera is None:
            points, *rest = (_unpacked(*array) for array in self._arrays)
            covariances = rest[0] if rest else None
            return RangeScan(points, covariances, self.camera, self.error_correlation)
        depth, variance = self._coded.depth()
        blank = np.zeros(depth.shape, np.uint8)
        spread = depth if variance is None else variance
        bands = RowBands(self.camera.height)
        packed = assemble(self.camera, depth, spread, self._pixel_sigma, blank, bands)
        covariances = None if variance is None else packed[..., 4:]
        return RangeScan(packed[..., :3], covariances, self.camera, self.error_correlation)


def keep_scan(
    points: ArrayLike,
    covariances: ArrayLike | None = None,
    camera: PinholeCamera | None = None,
    error_correlation: float | None = None,
) -> ScanRecord:
    """Bring a scan into the form in which it is kept.

    Args:
        points: shape (N, 3), or organized (H, W, 3), sensor frame [m]; NaN = no measurement.
        covariances: shape (..., 3, 3) or (..., 6) [m^2], or None.
        camera: whose pixels the points are, or None.
        error_correlation: of neighboring points, or None.

    Raises:
        InvalidInputError: the values are no numbers.
    """
    cloud = _floats(points, "points")
    spread = None if covariances is None else _floats(covariances, "covariances")
    farthest = float(np.sqrt(_largest_square(np.ascontiguousarray(cloud).reshape(-1, 3))))
    sigma = _pixel_sigma(cloud, spread, camera)
    if sigma is not None:
        variance = None if spread is None else _along(spread)
        coded = code_depth(cloud[..., 2], variance)
        return ScanRecord(camera, error_correlation, farthest, coded, sigma, ())
    arrays = tuple(_packed(array) for array in (cloud, spread) if array is not None)
    return ScanRecord(camera, error_correlation, farthest, None, 0.0, arrays)


def _pixel_sigma(
    points: NDArray[np.float32],
    covariances: NDArray[np.float32] | None,
    camera: PinholeCamera | None,
) -> float | None:
    """Pixel noise of a scan that a depth image with variances describes, None for any other."""
    if camera is None or points.shape != (camera.height, camera.width, 3):
        return None
    if covariances is None:
        return 0.0
    if covariances.shape not in ((*points.shape[:2], 6), (*points.shape[:2], 3, 3)):
        return None
    steps = [max(1, size // _SAMPLES_PER_SIDE) for size in points.shape[:2]]
    sample = points[:: steps[0], :: steps[1]].astype(np.float64)
    triangles = _triangles(covariances[:: steps[0], :: steps[1]]).astype(np.float64)
    with np.errstate(invalid="ignore"):
        usable = np.isfinite(triangles).all(axis=-1) & (triangles[..., 5] > 0.0)
        usable &= sample[..., 2] > 0.0
    return _fitted_sigma(sample[usable], triangles[usable], camera)


def _fitted_sigma(
    points: NDArray[np.float64], triangles: NDArray[np.float64], camera: PinholeCamera
) -> float | None:
    """Pixel noise with which the covariances, shape (N, 6), are as `assemble` makes them."""
    if not len(points):
        return 0.0
    z, along = points[:, 2], triangles[:, 5]
    x, y = points[:, 0] / z, points[:, 1] / z
    across = (triangles[:, 3] - y * y * along) * (camera.fy / z) ** 2
    sigma = float(np.sqrt(max(np.median(across), 0.0)))
    flat = (z * sigma) ** 2
    expected = along[:, None] * np.stack([x * x, x * y, x, y * y, y, np.ones_like(x)], axis=-1)
    expected[:, 0] += flat / camera.fx**2
    expected[:, 3] += flat / camera.fy**2
    size = triangles[:, 0] + triangles[:, 3] + triangles[:, 5]
    wrong = np.abs(expected - triangles).max(axis=1) > _TOLERANCE * size
    return sigma if not wrong.any() else None


@kernel
def _largest_square(points: Any) -> Any:
    """Square of the distance of the farthest point, 0 where there is none; points (n, 3) [m]."""
    largest = np.float32(0.0)
    for i in range(len(points)):
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        square = x * x + y * y + z * z
        if square < np.inf:
            largest = max(largest, square)
    return largest


def _along(covariances: NDArray[np.float32]) -> NDArray[np.float32]:
    """Variance along the optical axis, shape (...)."""
    return covariances[..., 5] if covariances.shape[-1] == 6 else covariances[..., 2, 2]


def _triangles(covariances: NDArray[np.float32]) -> NDArray[np.float32]:
    """Covariances as (xx, xy, xz, yy, yz, zz), shape (..., 6)."""
    if covariances.shape[-1] == 6:
        return covariances
    rows, columns = np.triu_indices(3)
    return covariances[..., rows, columns]


def _floats(values: ArrayLike, name: str) -> NDArray[np.float32]:
    """As float32, without a copy of what is that already."""
    if isinstance(values, np.ndarray) and values.dtype == np.float32:
        return values
    return float_array(values, name, np.float32)


def _packed(array: NDArray[np.float32]) -> tuple[tuple[int, ...], bytes]:
    return array.shape, zlib.compress(np.ascontiguousarray(array).data, _COMPRESSION)


def _unpacked(shape: tuple[int, ...], data: bytes) -> NDArray[np.float32]:
    return np.frombuffer(zlib.decompress(data), np.float32).reshape(shape)
