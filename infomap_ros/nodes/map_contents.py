"""The content of a voxel map in the forms in which it is published."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from infomap_ros.mapping import LOG_ODDS_QUANTUM, SHARED_LOG_ODDS_LIMIT, VoxelChanges, VoxelMap
from infomap_ros.mapping.export import surface_vertices
from infomap_ros.team import NOT_OBSERVED

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
    """Surface voxels as rows of `VOXEL_MAP_FIELDS`, shape (K, 5), float32.

    Position is the mean of the Gaussian [m, map]; sigma is the standard deviation of the surface
    along its normal [m].
    """
    vertices = surface_vertices(voxel_map)
    return np.stack([vertices[name].astype(np.float32) for name in VOXEL_MAP_FIELDS], axis=-1)


def without_evidence(indices: NDArray[np.int32]) -> VoxelChanges:
    """Voxels, shape (K, 3), of which nothing is known."""
    count = len(indices)
    return VoxelChanges(
        indices,
        np.full(count, NOT_OBSERVED, np.int8),
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
