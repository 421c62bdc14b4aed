"""Surface normals of an unorganized cloud, from the scatter of points in coarse cells."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit

from infomap_ros.mapping.scans.scan import row_of
from infomap_ros.mapping.voxels.keys import pack

CELL_VOXELS = 4.0
"""Edge length of a cell in voxels."""

_FEWEST = 5
_FLATNESS = 0.1
"""Largest share of the second smallest variance that the smallest may have in a flat cell."""

_BREADTH = 0.01
"""Smallest share of the largest variance that the second may have: a line has no normal."""


@njit(cache=True, nogil=True)
def cell_row(cells: Any, cell_size: float, x: float, y: float, z: float) -> Any:
    """Row of the cell that holds a point of the sensor frame [m], -1 when the storage is full."""
    scale = 1.0 / cell_size
    return row_of(
        cells, pack(int(np.floor(x * scale)), int(np.floor(y * scale)), int(np.floor(z * scale)))
    )


@njit(cache=True, nogil=True)
def gather_cells(cells: Any, points: Any, cell_size: float, max_range: float) -> bool:
    """Sum up the points of each cell.

    Args:
        cells: a `ScanRows`; receives number, sums and sums of products of the points, relative to
            their cell's corner, in its first ten columns.
        points: shape (n, 3), sensor frame [m].
        cell_size: [m].
        max_range: points farther away do not count [m].

    Returns:
        False when the storage is full.
    """
    sums = cells.sums
    for i in range(len(points)):
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        if not x * x + y * y + z * z <= max_range * max_range:
            continue
        row = cell_row(cells, cell_size, x, y, z)
        if row < 0:
            return False
        x -= np.floor(x / cell_size) * cell_size
        y -= np.floor(y / cell_size) * cell_size
        z -= np.floor(z / cell_size) * cell_size
        sums[row, 0] += 1.0
        sums[row, 1] += x
        sums[row, 2] += y
        sums[row, 3] += z
        sums[row, 4] += x * x
        sums[row, 5] += x * y
        sums[row, 6] += x * z
        sums[row, 7] += y * y
        sums[row, 8] += y * z
        sums[row, 9] += z * z
    return True


@njit(cache=True, nogil=True)
def find_normals(cells: Any) -> None:
    """Write the unit normal of each flat cell into columns 10 to 12, zero elsewhere."""
    sums = cells.sums
    scatter, mean = np.empty((3, 3)), np.empty(3)
    place = ((4, 5, 6), (5, 7, 8), (6, 8, 9))
    for row in range(cells.used[0]):
        count = np.float64(sums[row, 0])
        sums[row, 10], sums[row, 11], sums[row, 12] = 0.0, 0.0, 0.0
        if count < _FEWEST:
            continue
        for i in range(3):
            mean[i] = sums[row, 1 + i] / count
        for i in range(3):
            for j in range(3):
                scatter[i, j] = sums[row, place[i][j]] / count - mean[i] * mean[j]
        values, vectors = np.linalg.eigh(scatter)
        if values[0] < _FLATNESS * values[1] and values[1] > _BREADTH * values[2]:
            for i in range(3):
                sums[row, 10 + i] = vectors[i, 0]


@njit(cache=True, nogil=True)
def normal_at(cells: Any, cell_size: float, x: float, y: float, z: float, out: Any) -> None:
    """Unit normal at a point, facing the sensor; the line of sight where its cell is not flat."""
    row = cell_row(cells, cell_size, x, y, z)
    norm = np.sqrt(x * x + y * y + z * z)
    nx, ny, nz = -x / norm, -y / norm, -z / norm
    if row >= 0:
        a, b, c = cells.sums[row, 10], cells.sums[row, 11], cells.sums[row, 12]
        facing = a * nx + b * ny + c * nz
        if a * a + b * b + c * c > 0.0:
            sign = 1.0 if facing > 0.0 else -1.0
            nx, ny, nz = sign * a, sign * b, sign * c
    out[0], out[1], out[2] = nx, ny, nz
