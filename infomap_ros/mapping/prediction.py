"""What unknown voxels are probably like: the average of their neighbors.

Sujan and Dubowsky (2005, doi:10.1177/0278364905051774) give a voxel that was never observed the
average of its neighbors' probabilities, those of known voxels fixed, so that unknown regions take
after the closest known ones. That is a discrete Laplace equation over the unknown voxels. Far from
everything known it says little and costs much, so it is solved within a bounded distance of the
known, as if nothing were beyond; farther unknown voxels keep probability 0.5.

Solved by successive over-relaxation in the order of a checkerboard (Young 1954). The factor follows
from the depth of the unknown: the error that fades slowest is a wave twice that long.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from infomap_ros.geometry.config import check_config, parameter
from infomap_ros.mapping.config import LOG_ODDS_QUANTUM
from infomap_ros.mapping.voxels.window import UNKNOWN_QUANTA, VoxelWindow

_UNREACHED, _OUTSIDE = 0, 255


@dataclass(frozen=True)
class PredictionConfig:
    """How far and how exactly unknown voxels are predicted.

    Raises:
        ConfigError: a value is out of its range.
    """

    distance: int = parameter(
        8,
        "Unknown voxels up to this many steps from a known one are predicted.",
        unit="voxels",
        low=1,
        high=250,
    )
    tolerance: float = parameter(
        1e-3,
        "The iteration ends when no probability changes by more in one sweep.",
        low=1e-7,
        high=0.1,
    )
    iterations: int = parameter(500, "Most sweeps over the unknown voxels.", low=1, high=100_000)

    def __post_init__(self) -> None:
        check_config(self)


def predict_unknown(
    window: VoxelWindow, config: PredictionConfig | None = None
) -> NDArray[np.float32]:
    """Probability of occupancy of every voxel of a window.

    Args:
        window: known and unknown voxels; nothing outside it is looked at.
        config: distance and exactness.

    Returns:
        Shape of ``window.quanta``, float32: a known voxel's own probability; of an unknown one the
        average of its up to six neighbors, 0.5 where no known one is near.
    """
    limits = config or PredictionConfig()
    nx, ny, nz = window.quanta.shape
    values = np.zeros((nx + 2, ny + 2, nz + 2), np.float32)
    depth = np.zeros(values.shape, np.uint8)
    inner = (slice(1, -1),) * 3
    outside = np.ones(depth.shape, np.bool_)
    outside[inner] = False
    unknown = _enter_known(window.quanta, LOG_ODDS_QUANTUM, values, depth)
    depth[outside] = _OUTSIDE
    strides = (values.shape[1] * values.shape[2], values.shape[2])
    flat, queue = values.reshape(-1), np.empty(unknown, np.int64)
    deepest = _spread(flat, depth.reshape(-1), depth.shape, *strides, limits.distance, queue)
    depth[outside] = _UNREACHED
    cells, shares, reds = _unknown_cells(depth)
    factor = 2.0 / (1.0 + math.sin(math.pi / (2.0 * deepest + 2.0)))
    for _ in range(limits.iterations):
        change = _relax(flat, cells[:reds], shares[:reds], *strides, factor)
        change = max(change, _relax(flat, cells[reds:], shares[reds:], *strides, factor))
        if change <= limits.tolerance:
            break
    return np.where(depth[inner] == _UNREACHED, np.float32(0.5), values[inner])


@njit(cache=True, nogil=True)
def _enter_known(quanta: Any, quantum: float, values: Any, depth: Any) -> int:
    """Enter p of the known voxels and depth 1; returns the number of unknown ones."""
    nx, ny, nz = quanta.shape
    unknown = 0
    for i in range(nx):
        for j in range(ny):
            for k in range(nz):
                if quanta[i, j, k] == UNKNOWN_QUANTA:
                    unknown += 1
                    continue
                evidence = min(max(quanta[i, j, k] * quantum, -80.0), 80.0)
                values[i + 1, j + 1, k + 1] = 1.0 / (1.0 + math.exp(-evidence))
                depth[i + 1, j + 1, k + 1] = 1
    return unknown


@njit(cache=True, nogil=True)
def _spread(
    values: Any, depth: Any, shape: Any, row: int, column: int, distance: int, queue: Any
) -> int:
    """Reach, layer by layer, the unknown voxels within `distance` steps of known ones.

    Args:
        values: flat, with p of known voxels; receives a first guess of the others.
        depth: flat, 1 for known voxels, `_OUTSIDE` beyond the window; receives 1 + layer.
        shape: of the padded window.
        row: flat distance of neighbors along x.
        column: flat distance of neighbors along y.
        distance: number of layers.
        queue: room for every unknown voxel.

    Returns:
        Number of layers that hold any voxel.
    """
    nx, ny, nz = shape
    last = 0
    for i in range(1, nx - 1):
        for j in range(1, ny - 1):
            for k in range(1, nz - 1):
                at = i * row + j * column + k
                if depth[at] == _UNREACHED and _adopt(at, 1, row, column, values, depth):
                    queue[last] = at
                    last += 1
    first, layer = 0, 1
    while first < last and layer < distance:
        layer, end = layer + 1, last
        for n in range(first, end):
            for step in (-row, row, -column, column, -1, 1):
                at = queue[n] + step
                if depth[at] == _UNREACHED and _adopt(at, layer, row, column, values, depth):
                    queue[last] = at
                    last += 1
        first = end
    return layer


@njit(cache=True, nogil=True)
def _adopt(at: int, layer: int, row: int, column: int, values: Any, depth: Any) -> bool:
    """Give a voxel the mean of its neighbors in the layer before, if there are any."""
    total, count = 0.0, 0
    for step in (-row, row, -column, column, -1, 1):
        if depth[at + step] == layer:
            total += values[at + step]
            count += 1
    if count == 0:
        return False
    values[at], depth[at] = total / count, layer + 1
    return True


def _unknown_cells(
    depth: NDArray[np.uint8],
) -> tuple[NDArray[np.int64], NDArray[np.float32], int]:
    """Flat positions of the unknown voxels to predict and 1 / their neighbors, reds first."""
    count = int(np.count_nonzero(depth > 1))
    cells, shares = np.empty(count, np.int64), np.empty(count, np.float32)
    reds = _list_cells(depth, 0, cells, shares, 0)
    _list_cells(depth, 1, cells, shares, reds)
    return cells, shares, int(reds)


@njit(cache=True, nogil=True)
def _list_cells(depth: Any, color: int, cells: Any, shares: Any, found: int) -> int:
    nx, ny, nz = depth.shape
    for i in range(1, nx - 1):
        for j in range(1, ny - 1):
            for k in range(1 + (i + j + 1 + color) % 2, nz - 1, 2):
                if depth[i, j, k] > 1:
                    near = 0
                    near += depth[i - 1, j, k] > 0
                    near += depth[i + 1, j, k] > 0
                    near += depth[i, j - 1, k] > 0
                    near += depth[i, j + 1, k] > 0
                    near += depth[i, j, k - 1] > 0
                    near += depth[i, j, k + 1] > 0
                    cells[found] = (i * ny + j) * nz + k
                    shares[found] = np.float32(1.0) / np.float32(near)
                    found += 1
    return found


@njit(cache=True, nogil=True)
def _relax(values: Any, cells: Any, shares: Any, row: int, column: int, factor: float) -> Any:
    """One sweep over the cells of one color; what is not to be averaged holds 0."""
    largest, omega = np.float32(0.0), np.float32(factor)
    for n in range(len(cells)):
        at = cells[n]
        total = values[at - row] + values[at + row] + values[at - column]
        total += values[at + column] + values[at - 1] + values[at + 1]
        change = omega * (total * shares[n] - values[at])
        values[at] += change
        largest = max(largest, abs(change))
    return largest
