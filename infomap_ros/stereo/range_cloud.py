"""What a range sensor saw: one point with its covariance per pixel.

From a range image to points with covariances, in the layout of the message.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numba import njit
from numpy.typing import NDArray

from infomap_ros.geometry import PinholeCamera
from infomap_ros.geometry.kernel import kernel
from infomap_ros.stereo.config import StereoConfig
from infomap_ros.stereo.images import RowBands

#: Channels of `RangeCloud.packed`, in the order of the PointCloud2 fields of topic ``points2``.
PACKED_FIELDS = (
    "x",
    "y",
    "z",
    "rgb",
    "cov_xx",
    "cov_xy",
    "cov_xz",
    "cov_yy",
    "cov_yz",
    "cov_zz",
)
CORRELATION_FIELD, CORRELATION_OFFSET = "error_correlation", 15
"""Field of `RangeCloud.error_correlation` in hundredths, uint8: the byte that rgb leaves over."""
_FULL_FROM_TRIANGLE = np.array([[0, 1, 2], [1, 3, 4], [2, 4, 5]])


@dataclass(frozen=True, eq=False)
class RangeCloud:
    """An organized cloud in the optical frame of the (left) camera.

    The numbers live once, in `packed`, which is what the message carries; everything else is a
    view, or a copy that is made when it is asked for.

    Attributes:
        camera: the camera whose pixels the cloud is organized by.
        packed: shape (H, W, 10), float32, channels `PACKED_FIELDS`: point [m], color (bytes
            B, G, R of a little-endian float as in PCL, and `CORRELATION_FIELD` as the fourth),
            upper triangle of the covariance [m^2]. Point and covariance are NaN where nothing was
            measured. A depth camera that sees nothing within its range has a point there far beyond
            the range of any map.
        range_image: depth z, shape (H, W), float32 [m]; NaN where nothing was measured.
        error_correlation: mean correlation between the range errors of two pixels of one
            surface patch (about 5 to 15 px apart), 0 to 1. Averaging n such pixels reduces the
            variance to ``rho + (1 - rho) / n`` of one pixel's, not to ``1 / n``.
        disparity: shape (H, W), float32 [px], NaN invalid; None for a depth camera.
        disparity_sigma: predicted standard deviation of `disparity`, shape (H, W), float32
            [px], NaN invalid; None for a depth camera.
        colors: shape (H, W, 3), uint8 RGB, or None where no color image was given.
    """

    camera: PinholeCamera
    packed: NDArray[np.float32]
    range_image: NDArray[np.float32]
    error_correlation: float
    disparity: NDArray[np.float32] | None = None
    disparity_sigma: NDArray[np.float32] | None = None
    colors: NDArray[np.uint8] | None = None

    @cached_property
    def valid(self) -> NDArray[np.bool_]:
        """Pixels with a measurement, shape (H, W)."""
        return np.isfinite(self.range_image)

    @cached_property
    def points(self) -> NDArray[np.float32]:
        """Measured points in row order, shape (N, 3), float32 [m]."""
        return np.ascontiguousarray(self.packed[self.valid, :3])

    @cached_property
    def covariances(self) -> NDArray[np.float32]:
        """Covariances of `points`, shape (N, 3, 3), float32 [m^2]."""
        return self.packed[self.valid, 4:][:, _FULL_FROM_TRIANGLE]

    @property
    def organized_points(self) -> NDArray[np.float32]:
        """View of the points, shape (H, W, 3), float32 [m]; NaN where invalid."""
        return self.packed[..., :3]

    @property
    def covariance_triangles(self) -> NDArray[np.float32]:
        """View of (xx, xy, xz, yy, yz, zz), shape (H, W, 6), float32 [m^2]; NaN invalid."""
        return self.packed[..., 4:]

    @property
    def organized_covariances(self) -> NDArray[np.float32]:
        """Expanded covariances (a copy), shape (H, W, 3, 3), float32 [m^2]; NaN invalid."""
        return self.packed[..., 4:][..., _FULL_FROM_TRIANGLE]

    @property
    def density(self) -> float:
        """Share of pixels with a measurement, 0 to 1."""
        return float(self.valid.mean())


def mark_correlation(packed: NDArray[np.float32], error_correlation: float) -> NDArray[np.float32]:
    """Write `CORRELATION_FIELD` into channels of `RangeCloud.packed`, shape (H, W, 10)."""
    packed.view(np.uint8)[..., CORRELATION_OFFSET] = round(100.0 * error_correlation)
    return packed


def assemble(
    camera: PinholeCamera,
    depth: NDArray[np.float32],
    variance: NDArray[np.float32],
    pixel_sigma: float,
    image: NDArray[np.uint8],
    bands: RowBands,
) -> NDArray[np.float32]:
    """Points and covariances from depth noise along the ray and pixel noise across it.

    With the ray ``m = ((u - cx) / fx, (v - cy) / fy, 1)`` the point is ``z m`` and, to first
    order in the pixel noise, ``C = var(z) m m^T + (z sigma_px)^2 diag(1 / fx^2, 1 / fy^2, 0)``.

    Args:
        camera: the camera of the depth image.
        depth: z, shape (H, W) [m]; NaN where invalid.
        variance: of depth, shape (H, W) [m^2].
        pixel_sigma: standard deviation of the ray across the image [px].
        image: colors, shape (H, W, 3) RGB, or gray, shape (H, W).
        bands: threads to work in.

    Returns:
        Channels `PACKED_FIELDS`, shape (H, W, 10), float32; the point and the covariance are NaN
        where depth is.
    """
    x_per_z, y_per_z = _rays(camera)
    across = np.array([pixel_sigma / camera.fx, pixel_sigma / camera.fy], np.float32) ** 2
    packed = np.empty((*depth.shape, len(PACKED_FIELDS)), np.float32)
    colors = image if image.ndim == 3 else image[..., None]

    def work(first: int, end: int) -> None:
        planes = (array[first:end] for array in (y_per_z, depth, variance, colors, packed))
        _assemble_rays(x_per_z, across, *planes)

    bands.run(work)
    return packed


def assemble_printed(
    camera: PinholeCamera,
    focal_baseline: float,
    depth: NDArray[np.float32],
    config: StereoConfig,
    image: NDArray[np.uint8],
    bands: RowBands,
) -> NDArray[np.float32]:
    """Points with the covariance of eqs. (1) and (2): ``rho_ij sigma_i sigma_j``.

    Args:
        camera: left camera.
        focal_baseline: focal length times baseline [px m].
        depth: z, shape (H, W) [m]; NaN where invalid.
        config: printed_s, printed_t, printed_n and printed_rho.
        image: as for `assemble`.
        bands: threads to work in.

    Returns:
        As `assemble`.
    """
    per_axis = np.array(config.printed_t) * config.printed_s / focal_baseline
    rho = np.array(
        [
            [1.0, config.printed_rho[0], config.printed_rho[1]],
            [config.printed_rho[0], 1.0, config.printed_rho[2]],
            [config.printed_rho[1], config.printed_rho[2], 1.0],
        ]
    )
    unit = (rho * np.outer(per_axis, per_axis))[np.triu_indices(3)].astype(np.float32)
    x_per_z, y_per_z = _rays(camera)
    packed = np.empty((*depth.shape, len(PACKED_FIELDS)), np.float32)
    colors = image if image.ndim == 3 else image[..., None]

    def work(first: int, end: int) -> None:
        planes = (array[first:end] for array in (y_per_z, depth, colors, packed))
        _assemble_printed(x_per_z, unit, np.float32(config.printed_n), *planes)

    bands.run(work)
    return packed


def _rays(camera: PinholeCamera) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    x_per_z = (np.arange(camera.width) - camera.cx) / camera.fx
    y_per_z = (np.arange(camera.height) - camera.cy) / camera.fy
    return x_per_z.astype(np.float32), y_per_z.astype(np.float32)


@kernel
def _assemble_rays(  # type: ignore[no-untyped-def]
    x_per_z, across, y_per_z, depth, variance, colors, packed
):
    height, width = depth.shape
    bits = packed.view(np.uint32)
    for v in range(height):
        b = y_per_z[v]
        for u in range(width):
            a, z = x_per_z[u], depth[v, u]
            along = variance[v, u] + np.float32(0.0) * z  # NaN where depth is
            square = z * z
            packed[v, u, 0] = a * z
            packed[v, u, 1] = b * z
            packed[v, u, 2] = z
            bits[v, u, 3] = _color(colors, v, u)
            packed[v, u, 4] = a * a * along + across[0] * square
            packed[v, u, 5] = a * b * along
            packed[v, u, 6] = a * along
            packed[v, u, 7] = b * b * along + across[1] * square
            packed[v, u, 8] = b * along
            packed[v, u, 9] = along


@kernel
def _assemble_printed(  # type: ignore[no-untyped-def]
    x_per_z, unit, exponent, y_per_z, depth, colors, packed
):
    height, width = depth.shape
    bits = packed.view(np.uint32)
    for v in range(height):
        b = y_per_z[v]
        for u in range(width):
            a, z = x_per_z[u], depth[v, u]
            packed[v, u, 0] = a * z
            packed[v, u, 1] = b * z
            packed[v, u, 2] = z
            bits[v, u, 3] = _color(colors, v, u)
            distance = z * np.sqrt(a * a + b * b + np.float32(1.0))
            scale = distance ** (np.float32(2.0) * exponent)
            for i in range(6):
                packed[v, u, 4 + i] = unit[i] * scale


@njit(nogil=True, cache=True, inline="always", error_model="numpy")
def _color(colors, v, u):  # type: ignore[no-untyped-def]
    """Color of a pixel as 0x00RRGGBB; a gray image has one channel."""
    green, blue = (1, 2) if colors.shape[2] == 3 else (0, 0)
    red_bits = np.uint32(colors[v, u, 0]) << np.uint32(16)
    green_bits = np.uint32(colors[v, u, green]) << np.uint32(8)
    return red_bits | green_bits | np.uint32(colors[v, u, blue])
