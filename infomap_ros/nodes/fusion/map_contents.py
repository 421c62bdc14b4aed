"""The content of a voxel map in the forms in which it is published."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from infomap_ros.mapping import NOT_OBSERVED, VoxelChanges, VoxelMap
from infomap_ros.mapping.files.export import surface_vertices

VOXEL_MAP_FIELDS = ("x", "y", "z", "probability", "sigma")


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
