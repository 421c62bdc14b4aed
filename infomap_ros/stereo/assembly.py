"""From a range image to points with covariances, in the layout of the message."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from infomap_ros.geometry import PinholeCamera
from infomap_ros.stereo.bands import RowBands
from infomap_ros.stereo.config import StereoConfig
from infomap_ros.stereo.range_cloud import PACKED_FIELDS


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
        image: colours, shape (H, W, 3) RGB, or grey, shape (H, W).
        bands: threads to work in.

    Returns:
        Channels `PACKED_FIELDS`, shape (H, W, 10), float32; the point and the covariance are NaN
        where depth is.
    """
    x_per_z, y_per_z = _rays(camera)
    across = np.array([pixel_sigma / camera.fx, pixel_sigma / camera.fy], np.float32) ** 2
    packed = np.empty((*depth.shape, len(PACKED_FIELDS)), np.float32)

    def work(first: int, end: int) -> None:
        _pack_colours(image[first:end], packed[first:end])
        planes = (array[first:end] for array in (depth, variance))
        _assemble_rays(x_per_z, y_per_z[first:end], *planes, across, packed[first:end])

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

    def work(first: int, end: int) -> None:
        _pack_colours(image[first:end], packed[first:end])
        rows = (array[first:end] for array in (y_per_z, depth, packed))
        _assemble_printed(x_per_z, *rows, unit, np.float32(config.printed_n))

    bands.run(work)
    return packed


def _pack_colours(image: NDArray[np.uint8], packed: NDArray[np.float32]) -> None:
    colours = image if image.ndim == 3 else image[..., None]
    _colour_kernel(colours, packed.view(np.uint32))


def _rays(camera: PinholeCamera) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    x_per_z = (np.arange(camera.width) - camera.cx) / camera.fx
    y_per_z = (np.arange(camera.height) - camera.cy) / camera.fy
    return x_per_z.astype(np.float32), y_per_z.astype(np.float32)


@njit(nogil=True, cache=True, error_model="numpy")
def _colour_kernel(colours, packed):  # type: ignore[no-untyped-def]
    height, width, channels = colours.shape
    green, blue = (1, 2) if channels == 3 else (0, 0)
    for v in range(height):
        for u in range(width):
            packed[v, u, 3] = (
                (np.uint32(colours[v, u, 0]) << np.uint32(16))
                | (np.uint32(colours[v, u, green]) << np.uint32(8))
                | np.uint32(colours[v, u, blue])
            )


@njit(nogil=True, cache=True, error_model="numpy")
def _assemble_rays(x_per_z, y_per_z, depth, variance, across, packed):  # type: ignore[no-untyped-def]
    height, width = depth.shape
    for v in range(height):
        b = y_per_z[v]
        for u in range(width):
            a, z = x_per_z[u], depth[v, u]
            along = variance[v, u] + np.float32(0.0) * z  # NaN where depth is
            square = z * z
            packed[v, u, 0] = a * z
            packed[v, u, 1] = b * z
            packed[v, u, 2] = z
            packed[v, u, 4] = a * a * along + across[0] * square
            packed[v, u, 5] = a * b * along
            packed[v, u, 6] = a * along
            packed[v, u, 7] = b * b * along + across[1] * square
            packed[v, u, 8] = b * along
            packed[v, u, 9] = along


@njit(nogil=True, cache=True, error_model="numpy")
def _assemble_printed(x_per_z, y_per_z, depth, packed, unit, exponent):  # type: ignore[no-untyped-def]
    height, width = depth.shape
    for v in range(height):
        b = y_per_z[v]
        for u in range(width):
            a, z = x_per_z[u], depth[v, u]
            packed[v, u, 0] = a * z
            packed[v, u, 1] = b * z
            packed[v, u, 2] = z
            distance = z * np.sqrt(a * a + b * b + np.float32(1.0))
            scale = distance ** (np.float32(2.0) * exponent)
            for i in range(6):
                packed[v, u, 4 + i] = unit[i] * scale
