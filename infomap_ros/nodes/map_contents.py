"""The content of a voxel map in the forms in which it is published."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from infomap_ros.mapping import LOG_ODDS_QUANTUM, SHARED_LOG_ODDS_LIMIT, VoxelChanges, VoxelMap

VOXEL_MAP_FIELDS = ("x", "y", "z", "probability", "sigma")


def whole_map(voxel_map: VoxelMap) -> VoxelChanges:
    """Every known voxel of a map, as `VoxelMap.take_changes` would tell it."""
    indices, log_odds = voxel_map.voxels()
    quanta = np.rint(log_odds / LOG_ODDS_QUANTUM)
    quanta = np.clip(quanta, -SHARED_LOG_ODDS_LIMIT, SHARED_LOG_ODDS_LIMIT).astype(np.int8)
    changes = without_evidence(indices)
    changes.log_odds[:] = quanta
    surface, means, covariances = voxel_map.gaussians()
    rows = _find_rows(indices, surface)
    changes.has_gaussian[rows] = True
    changes.means[rows], changes.covariances[rows] = means, covariances
    return changes


def voxel_map_rows(voxel_map: VoxelMap) -> NDArray[np.float32]:
    """Surface voxels as rows (x, y, z, probability, sigma), shape (K, 5).

    Position is the mean of the Gaussian [m, map]; sigma is the standard deviation of the surface
    along its normal, the smallest of the Gaussian [m].
    """
    _, means, covariances = voxel_map.gaussians()
    rows = np.empty((len(means), len(VOXEL_MAP_FIELDS)), dtype=np.float32)
    rows[:, :3] = means
    rows[:, 3] = voxel_map.probability(means) if len(means) else 0.0
    rows[:, 4] = np.sqrt(np.linalg.eigvalsh(covariances)[:, 0]) if len(means) else 0.0
    return rows


def projected_cells(
    voxel_map: VoxelMap, low: float, high: float
) -> tuple[NDArray[np.int8], tuple[float, float]]:
    """The map between two heights, seen from above.

    Args:
        voxel_map: the map.
        low: voxels with their centre from here [m] ...
        high: ... to here [m] count.

    Returns:
        Cells, shape (rows along y, columns along x): -1 where nothing is known, else the highest
        occupancy probability of the column in percent; and x, y of the corner of cell (0, 0) [m].
    """
    size = voxel_map.config.voxel_size
    indices, log_odds = voxel_map.voxels()
    heights = (indices[:, 2] + 0.5) * size
    chosen = (heights >= low) & (heights <= high)
    columns, evidence = indices[chosen, :2], log_odds[chosen].astype(np.float64)
    if not len(columns):
        return np.full((1, 1), -1, dtype=np.int8), (0.0, 0.0)
    first = columns.min(axis=0)
    width, depth = columns.max(axis=0) - first + 1
    percent = np.rint(100.0 / (1.0 + np.exp(-np.clip(evidence, -50.0, 50.0)))).astype(np.int8)
    cells = np.full((depth, width), -1, dtype=np.int8)
    x, y = (columns - first).T
    np.maximum.at(cells, (y, x), percent)
    return cells, (float(first[0] * size), float(first[1] * size))


def without_evidence(indices: NDArray[np.int32]) -> VoxelChanges:
    """Voxels, shape (K, 3), of which nothing is known: log-odds 0 and no Gaussian."""
    count = len(indices)
    return VoxelChanges(
        indices,
        np.zeros(count, np.int8),
        np.zeros(count, np.bool_),
        np.full((count, 3), np.nan),
        np.full((count, 3, 3), np.nan),
    )


def _find_rows(indices: NDArray[np.int32], wanted: NDArray[np.int32]) -> NDArray[np.intp]:
    """Rows of `indices` that hold the `wanted` voxels."""
    keys, targets = (_packed(values) for values in (indices, wanted))
    order = np.argsort(keys)
    return order[np.searchsorted(keys, targets, sorter=order)]


def _packed(indices: NDArray[np.int32]) -> NDArray[np.int64]:
    shifted = indices.astype(np.int64) + 2**20
    return np.asarray((shifted[:, 0] << 42) | (shifted[:, 1] << 21) | shifted[:, 2])
