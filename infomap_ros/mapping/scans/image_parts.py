"""Parts of an organized scan that are about equal work.

Each thread gathers one part. One cut is shared by the fewest voxels, so it is better than many
small strips in turn; where it lies follows from the scan alone, so the map does not depend on which
thread is faster.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from infomap_ros.geometry.kernel import inlined_kernel, kernel
from infomap_ros.mapping.scans.association import NEAREST, Sensor
from infomap_ros.mapping.scans.organized import OrganizedScan
from infomap_ros.mapping.scans.tiles import TILE

_STEP = 4
"""Of so many tiles of a strip, one is looked at."""

_APART, _MOST_VOXELS = 3, 24.0
"""A tile is measured over so many pixels, and taken for no larger than this [voxels]."""

_IN_RANGE, _VOXEL = 4.0, 0.15
"""Work on a tile in range, and on each voxel that it informs; out of range it is 1."""


def rows_of_parts(image: OrganizedScan, sensor: Sensor, parts: int) -> list[int]:
    """First row of each part, multiples of 8, and the height of the image at the end."""
    height = image.points.shape[0]
    if parts == 1:
        return [0, height]
    work = np.empty(-(-height // TILE))
    _estimate_work(sensor, image, work)
    done = np.cumsum(work)
    shares = done[-1] * np.arange(1, parts) / parts
    strips = np.searchsorted(done - 0.5 * work, shares)
    return [0, *(np.minimum(strips, len(work) - 1) * TILE).tolist(), height]


@kernel
def _estimate_work(sensor: Any, image: Any, work: Any) -> None:
    """Estimate the work on each strip of 8 rows from some of its pixels.

    Args:
        sensor: a `Sensor`.
        image: an `OrganizedScan`.
        work: receives the estimate, in units of a tile that is out of range, shape (strips,).
    """
    points, covariances, column = image.points, image.covariances, image.columns[5]
    height, width = points.shape[0], points.shape[1]
    stride = 0 if len(covariances) == 1 else 1
    for strip in range(len(work)):
        v = min(strip * TILE + TILE // 2, height - 1)
        total = 0.0
        for u in range((strip % _STEP) * TILE + TILE // 2, width, _STEP * TILE):
            total += 1.0
            x, y, z = points[v, u, 0], points[v, u, 1], points[v, u, 2]
            if z > NEAREST and x * x + y * y + z * z <= sensor.max_range**2:
                variance = covariances[stride * (v * width + u), column]
                reach = min(sensor.limit, sensor.sigmas * np.sqrt(variance) * sensor.inverse_size)
                along = _extent(points, v, u, 0, _APART) * sensor.inverse_size
                down = _extent(points, v, u, _APART, 0) * sensor.inverse_size
                total += _IN_RANGE + _VOXEL * _voxels(along) * _voxels(down) * (1.0 + 2.0 * reach)
        work[strip] = total


@inlined_kernel
def _extent(points: Any, v: int, u: int, dv: int, du: int) -> float:
    """Distance between two pixels, as it would be across a tile [m]; 0 where one is missing."""
    if v + dv >= points.shape[0] or u + du >= points.shape[1]:
        return 0.0
    dx = points[v + dv, u + du, 0] - points[v, u, 0]
    dy = points[v + dv, u + du, 1] - points[v, u, 1]
    dz = points[v + dv, u + du, 2] - points[v, u, 2]
    distance = np.sqrt(dx * dx + dy * dy + dz * dz) * (TILE / _APART)
    return distance if distance < np.inf else 0.0


@inlined_kernel
def _voxels(extent: float) -> float:
    """Voxels that an extent [voxels] crosses."""
    return 1.0 + min(extent, _MOST_VOXELS)
