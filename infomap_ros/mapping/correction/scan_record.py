"""Scans in the form in which they are kept: small, and always the same when they are taken out.

A scan of a pinhole camera whose covariances are those of range noise along the ray and pixel noise
across it (`infomap_ros.stereo.range_cloud`) is kept as a coded depth image. Any other scan, an
unorganized cloud or one with other covariances, is kept as it is, compressed.

Depth images and their noise in few bytes: quantized, predicted from the left, compressed.

Depth is kept as inverse depth in equal steps, for that is where the noise of stereo is even; its
standard deviation as a logarithm. A code is told as its difference from the code of the pixel to
the left, which is small on surfaces, and the differences are compressed with zlib. Those that are
mostly noise are compressed by the frequency of values alone: quicker than to look for repetitions,
and smaller.
"""

from __future__ import annotations

import zlib
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from infomap_ros.geometry import PinholeCamera, float_array
from infomap_ros.geometry.kernel import kernel
from infomap_ros.stereo.images import RowBands
from infomap_ros.stereo.range_cloud import assemble

_LARGEST_CODE = 65535
_SIGMA_CODES, _SIGMA_STEP = 255, 0.04
_STEPS_PER_SIGMA = 4.0
_LEAST_SHARE = 0.01
_COMPRESSION = 1  # of zlib: the fastest
_STRATEGIES = (zlib.Z_DEFAULT_STRATEGY, zlib.Z_HUFFMAN_ONLY) * 2


@dataclass(frozen=True, eq=False)
class CodedDepth:
    """A depth image in few bytes.

    Attributes:
        shape: (H, W).
        step: of the inverse depth [1/m]; no more than a quarter of its standard deviation in 99 of
            100 pixels, so that rounding adds no more than half a percent to the variance.
        sigma_low: smallest standard deviation of the inverse depth [1/m], 0 where none is kept.
        sigma_step: of its natural logarithm, 0.04 or more: one part in fifty.
        planes: compressed codes: is measured, low and high byte of depth, sigma if it is kept.
    """

    shape: tuple[int, int]
    step: float
    sigma_low: float
    sigma_step: float
    planes: tuple[bytes, ...]

    def memory_bytes(self) -> int:
        """Memory in use by the codes [bytes]."""
        return sum(len(plane) for plane in self.planes)

    def depth(self) -> tuple[NDArray[np.float32], NDArray[np.float32] | None]:
        """Depth z, shape (H, W) [m], NaN where there is none, and its variance [m^2] or None."""
        codes = [np.frombuffer(zlib.decompress(plane), np.uint8) for plane in self.planes]
        pixels = self.shape[0] * self.shape[1]
        depth, variance = np.empty(pixels, np.float32), np.empty(pixels, np.float32)
        levels = np.exp(self.sigma_step * np.arange(256)) * self.sigma_low
        _decode(np.stack(codes), self.step, levels.astype(np.float64), depth, variance)
        has_sigma = self.sigma_low > 0.0
        return depth.reshape(self.shape), variance.reshape(self.shape) if has_sigma else None


def code_depth(depth: NDArray[np.float32], variance: NDArray[np.float32] | None) -> CodedDepth:
    """Keep a depth image in few bytes.

    Args:
        depth: z, shape (H, W) [m]; what is not positive or not finite is no measurement.
        variance: of z, shape (H, W) [m^2], or None. A pixel without a positive one is not kept.
    """
    pixels = np.ascontiguousarray(depth).reshape(-1)
    spread = np.empty(0, np.float32)
    if variance is not None:
        spread = np.ascontiguousarray(variance).reshape(-1)
    sigma = np.empty(pixels.size, np.float32)
    largest = float(_describe(pixels, spread, sigma))
    step, low, sigma_step = _scales(largest, None if variance is None else sigma)
    planes = np.zeros((4 if variance is not None else 3, pixels.size), np.uint8)
    log_sigma = np.log(sigma / np.float32(low)) if low else sigma
    _encode(pixels, log_sigma, step, 1.0 / sigma_step, planes)
    codes = tuple(map(_compressed, planes, _STRATEGIES))
    return CodedDepth((depth.shape[0], depth.shape[1]), step, low, sigma_step, codes)


def _compressed(plane: NDArray[np.uint8], strategy: int) -> bytes:
    compression = zlib.compressobj(_COMPRESSION, strategy=strategy)
    return compression.compress(plane.data) + compression.flush()


def _scales(largest: float, sigma: NDArray[np.float32] | None) -> tuple[float, float, float]:
    """Step of the inverse depth, smallest sigma and step of its logarithm.

    Args:
        largest: inverse depth [1/m], 0 if nothing was measured.
        sigma: of the inverse depth [1/m], NaN where nothing was measured, or None.
    """
    if largest == 0.0:
        return 1.0, 0.0 if sigma is None else 1.0, 1.0
    step = largest / (_LARGEST_CODE - 1)
    if sigma is None:
        return step, 0.0, 1.0
    known = sigma[~np.isnan(sigma)]
    place = int(_LEAST_SHARE * len(known))
    typical = float(np.partition(known, place)[place])
    low, high = float(known.min()), float(known.max())
    sigma_step = max(float(np.log(high / low)) / _SIGMA_CODES, _SIGMA_STEP)
    return max(step, typical / _STEPS_PER_SIGMA), low, sigma_step


@kernel
def _describe(depth: Any, variance: Any, sigma: Any) -> float:
    """Largest inverse depth, 0 where nothing was measured [1/m].

    Args:
        depth: z, shape (n,) [m].
        variance: of z, shape (n,) [m^2], or empty.
        sigma: receives the standard deviation of the inverse depth, or any number where there is
            no variance, float32, shape (n,) [1/m]; NaN where there is no measurement.
    """
    largest = 0.0
    for i in range(len(depth)):
        rho = 1.0 / np.float64(depth[i])
        value = np.float32(1.0)
        if len(variance):
            value = np.float32(np.sqrt(np.float64(variance[i])) * rho * rho)
        valid = rho > 0.0 and rho < np.inf and value > 0.0 and value < np.inf
        sigma[i] = value if valid else np.float32(np.nan)
        largest = max(largest, rho if valid else 0.0)
    return largest


@kernel
def _encode(
    depth: Any, log_sigma: Any, step: float, inverse_sigma_step: float, planes: Any
) -> None:
    """Fill the planes: is measured, low and high byte of depth, sigma; differences but the first.

    Args:
        depth: z, shape (n,) [m].
        log_sigma: logarithm of sigma over the smallest, shape (n,), NaN where not measured.
        step: of the inverse depth [1/m].
        inverse_sigma_step: 1 / step of log_sigma.
        planes: receives bytes, zero before, shape (3 or 4, n).
    """
    before, sigma_before = np.int64(0), np.int64(0)
    for i in range(len(depth)):
        if np.isnan(log_sigma[i]):
            continue
        code = np.int64(min(max(1.0 / (np.float64(depth[i]) * step) + 0.5, 1.0), 65535.0))
        difference = (code - before) & 0xFFFF
        folded = ((difference << 1) ^ (0xFFFF if difference & 0x8000 else 0)) & 0xFFFF
        planes[0, i] = 1
        planes[1, i], planes[2, i] = folded & 0xFF, folded >> 8
        before = code
        if len(planes) > 3:
            code = np.int64(min(max(log_sigma[i] * inverse_sigma_step + 0.5, 0.0), 255.0))
            planes[3, i] = (code - sigma_before) & 0xFF
            sigma_before = code


@kernel
def _decode(planes: Any, step: float, levels: Any, depth: Any, variance: Any) -> None:
    """Inverse of `_encode`: depth [m] and variance [m^2], NaN where not measured.

    Args:
        planes: bytes, shape (3 or 4, n).
        step: of the inverse depth [1/m].
        levels: standard deviation of the inverse depth by code, shape (256,).
        depth: receives z, shape (n,).
        variance: receives its variance, shape (n,).
    """
    code, sigma_code = np.int64(0), np.int64(0)
    for i in range(len(depth)):
        if planes[0, i] == 0:
            depth[i] = variance[i] = np.nan
            continue
        folded = np.int64(planes[1, i]) | (np.int64(planes[2, i]) << 8)
        difference = (folded >> 1) ^ (0xFFFF if folded & 1 else 0)
        code = (code + difference) & 0xFFFF
        z = 1.0 / (code * step)
        depth[i] = z
        if len(planes) > 3:
            sigma_code = (sigma_code + planes[3, i]) & 0xFF
            deviation = levels[sigma_code] * z * z
            variance[i] = deviation * deviation


_TOLERANCE = 0.02
_SAMPLES_PER_SIDE = 48
_BYTES_OF_OBJECTS = 1000  # about what the Python objects of a record need


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
