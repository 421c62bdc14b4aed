"""A fingerprint of what a map holds, whatever the order in which it came in."""

from __future__ import annotations

import hashlib

import numpy as np

from infomap_ros.mapping import VoxelMap


def map_hash(voxel_map: VoxelMap) -> str:
    """SHA-256 of all voxels, their evidence and their Gaussians, to the last bit; hexadecimal."""
    digest = hashlib.sha256()
    for content in (voxel_map.voxels(), voxel_map.gaussians()):
        order = np.lexsort(content[0].T)
        for values in content:
            digest.update(np.ascontiguousarray(values[order]).tobytes())
    return digest.hexdigest()
