"""Inverse depths between the pixels of a range cloud."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.stereo import RangeCloud

_REACH = 2  # pixels about the nearest one that take part
_LEAST_SAMPLES = 12
# Neighbors whose inverse depth differs by a larger share belong to another surface.
_SAME_SURFACE = 0.05
_DEPTH_VARIANCE = 5  # channel (zz) of the covariance triangle


def sample_inverse_depths(cloud: RangeCloud, pixels: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Measure 1/z between pixels by a plane through the neighbors.

    The inverse depth of a plane is linear in the pixel, so the fit is exact on planes. Averaging n
    neighbors leaves ``rho + (1 - rho) / n`` of the variance, with the cloud's error correlation
    rho; what neither the plane nor the noise explains is added.

    Args:
        cloud: organized.
        pixels: (u, v), shape (N, 2) [px].

    Returns:
        Inverse depths and standard deviations, shape (N,) each [1/m]; NaN where fewer than 12 of
        the 25 neighbors, or neighbors to one side only, were measured.
    """
    height, width = cloud.range_image.shape
    inside = np.asarray(np.isfinite(pixels).all(axis=1))
    nearest = np.rint(np.where(inside[:, None], pixels, 0.0)).astype(np.int64)
    inside &= ((nearest >= _REACH) & (nearest < np.array([width, height]) - _REACH)).all(axis=1)
    inverse, sigma = np.full(len(pixels), np.nan), np.full(len(pixels), np.nan)
    if inside.any():
        inverse[inside], sigma[inside] = _fit(cloud, pixels[inside], nearest[inside])
    return inverse, sigma


def _fit(
    cloud: RangeCloud, pixels: FloatArray, nearest: NDArray[np.int64]
) -> tuple[FloatArray, FloatArray]:
    offsets = np.arange(-_REACH, _REACH + 1)
    across, down = (plane.ravel() for plane in np.meshgrid(offsets, offsets))
    columns, rows = nearest[:, :1] + across, nearest[:, 1:] + down
    depth = cloud.range_image[rows, columns].astype(np.float64)
    variance = cloud.covariance_triangles[rows, columns, _DEPTH_VARIANCE].astype(np.float64)
    values, noise = 1.0 / depth, variance / depth**4
    # Sorting puts NaN last, so that the median of those that were measured is at half their count.
    half = np.isfinite(values).sum(axis=1, keepdims=True) // 2
    middle = np.take_along_axis(np.sort(values, axis=1), half, axis=1)
    with np.errstate(invalid="ignore"):
        used = np.abs(values - middle) < _SAME_SURFACE * middle
    weights = used.astype(np.float64)
    design = np.stack(
        [np.ones_like(values), columns - pixels[:, :1], rows - pixels[:, 1:]], axis=-1
    )
    normal = np.einsum("nk,nki,nkj->nij", weights, design, design)
    sound = (weights.sum(axis=1) >= _LEAST_SAMPLES) & (np.linalg.det(normal) > 1.0)
    normal[~sound] = np.eye(3)
    values, noise = np.where(used, values, 0.0), np.where(used, noise, 0.0)
    right_side = np.einsum("nk,nki,nk->ni", weights, design, values)
    plane = np.linalg.solve(normal, right_side[..., None])[..., 0]
    spread = np.linalg.inv(normal)[:, 0, 0]
    residual = weights * (values - np.einsum("nki,ni->nk", design, plane))
    count = np.maximum(weights.sum(axis=1), _LEAST_SAMPLES)
    mean_noise = (weights * noise).sum(axis=1) / count
    rho = cloud.error_correlation
    scatter = (residual**2).sum(axis=1) / (count - 3.0)
    left_over = np.maximum(scatter - (1.0 - rho) * mean_noise, 0.0)
    total = mean_noise * (rho + (1.0 - rho) * spread) + left_over * spread
    good = sound & (plane[:, 0] > 0.0)
    return np.where(good, plane[:, 0], np.nan), np.where(good, np.sqrt(total), np.nan)
