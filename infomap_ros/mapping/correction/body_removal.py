"""A body taken out of what was fused before anybody knew that it is one.

A robot that stands in view before it joins, or while it is silent for long, is a part of the scene
to who looks at it. When it is heard, it would stand within its own image, and could not move.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from infomap_ros.geometry import PlacedSolid, invert_transform
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.mapping.correction.scan_record import ScanRecord, keep_scan
from infomap_ros.mapping.scans.body import BodyFilterConfig, body_mask
from infomap_ros.mapping.voxel_map import VoxelMap
from infomap_ros.mapping.voxels.block_exchange import exchange_blocks
from infomap_ros.mapping.voxels.blocks import BLOCK_COUNT
from infomap_ros.mapping.voxels.keys import pack_all
from infomap_ros.mapping.voxels.voxel_states import put_states, unknown_states


def forget_body(
    voxel_map: VoxelMap,
    solids: Sequence[PlacedSolid],
    config: BodyFilterConfig | None = None,
    ground: FloatArray | None = None,
) -> int:
    """Make the occupied voxels of a body unknown; they count as changed.

    A voxel is of the body by the rule for points of scans (`infomap_ros.mapping.scans.body`): its
    surface point is, or where it has none its center, of which it may be anywhere in the voxel.

    Args:
        voxel_map: the map.
        solids: of the body, placed in the map.
        config: how far it is grown.
        ground: (n, d), shape (4,): what lies at p with ``n . p < d`` [m] is that on which the body
            stands, and stays.

    Returns:
        Number of the voxels.
    """
    if not solids:
        return 0
    size = voxel_map.config.voxel_size
    indices, log_odds = voxel_map.voxels()
    occupied = indices[log_odds > 0.0]
    surface, means, covariances = voxel_map.gaussians(relative=True)
    has_surface = np.isin(pack_all(occupied.astype(np.int64)), pack_all(surface.astype(np.int64)))
    bare = occupied[~has_surface]
    anywhere = np.broadcast_to(size**2 / 12.0 * np.eye(3), (len(bare), 3, 3))
    centers = (bare + 0.5) * size
    of_body = body_mask(centers, anywhere, solids, config)
    surface_of_body = body_mask(means, covariances, solids, config)
    if ground is not None:
        of_body &= centers @ ground[:3] >= ground[3] + 0.5 * size
        surface_of_body &= means @ ground[:3] >= ground[3]
    forgotten = np.concatenate([bare[of_body], surface[surface_of_body]])
    if len(forgotten):
        _forget(voxel_map, forgotten)
    return len(forgotten)


def _forget(voxel_map: VoxelMap, indices: NDArray[np.int32]) -> None:
    """Make voxels unknown, shape (K, 3)."""
    fresh = VoxelMap.from_state(voxel_map.config, voxel_map.state())
    put_states(fresh._storage, unknown_states(indices))
    everywhere = np.ones(int(voxel_map._storage.blocks.counts[BLOCK_COUNT]), np.bool_)
    voxel_map._storage = exchange_blocks(voxel_map._storage, fresh._storage, everywhere)


def without_body(
    record: ScanRecord,
    T_map_sensor: FloatArray,
    solids: Sequence[PlacedSolid],
    config: BodyFilterConfig | None = None,
) -> ScanRecord | None:
    """A kept scan without its points on a body; None where there are none.

    Args:
        record: the scan.
        T_map_sensor: shape (4, 4).
        solids: of the body, placed in the map.
        config: how far it is grown.
    """
    T_sensor_map = invert_transform(T_map_sensor)
    placed = [PlacedSolid(s.solid, T_sensor_map @ s.transform, s.name) for s in solids]
    scan = record.restore()
    on_body = body_mask(scan.points, scan.covariances, placed, config)
    if not on_body.any():
        return None
    points = np.where(on_body[..., None], np.float32(np.nan), scan.points)
    cut = keep_scan(points, scan.covariances, scan.camera, scan.error_correlation)
    return replace(cut, farthest=record.farthest)
