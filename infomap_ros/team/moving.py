"""A contribution that belongs elsewhere: its map after a corrected alignment.

Where the scans are kept they are better put where they belong (`mapping.reintegration`); this is
for a map of which only the voxels are left.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from infomap_ros.geometry import check_transform, invert_transform, skew, transform_points
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.mapping import LOG_ODDS_QUANTUM, VoxelMap
from infomap_ros.mapping.voxels.changes import put_offset
from infomap_ros.mapping.voxels.voxel_states import VoxelStates, information_of, put_states


def moved_map(voxel_map: VoxelMap, T_new_old: ArrayLike) -> VoxelMap:
    """A map whose content is moved; tracks its changes.

    The evidence of a voxel is that of the place from which its center comes. Gaussians are moved
    as they are, each into the voxel in which its mean then lies; of several in one voxel the
    surest is kept, as they may be of one observation. That voxel is occupied. The error that the
    whole map shares moves with it.

    Args:
        voxel_map: what is moved; stays as it is.
        T_new_old: takes map coordinates as they were to those that are right, shape (4, 4).

    Raises:
        InvalidInputError: not a rigid transform.
    """
    transform = check_transform(T_new_old, "T_new_old")
    size = voxel_map.config.voxel_size
    indices = _reached(voxel_map, transform)
    sources = transform_points(invert_transform(transform), (indices + 0.5) * size)
    known = voxel_map.is_known(sources)
    indices, quanta = indices[known], np.rint(voxel_map.log_odds(sources[known]) / LOG_ODDS_QUANTUM)
    moved = VoxelMap(voxel_map.config)
    moved.track_changes(True)
    nothing = np.zeros((len(indices), 9), np.float32)
    present = np.ones(len(indices), np.bool_)
    put_states(moved._storage, VoxelStates(indices, present, quanta.astype(np.int32), nothing))
    put_states(moved._storage, _moved_surfaces(voxel_map, transform))
    put_offset(moved._storage, _moved_offset(voxel_map.offset, transform))
    return moved


def _moved_offset(offset: FloatArray, T_new_old: FloatArray) -> FloatArray:
    """The covariance of a map's offset at its origin, (6, 6), told at another one.

    An error (dt, dr) takes a point p by dt + dr x p, and so the moved one, R p + t, by
    R dt - (R dr) x t + (R dr) x (R p + t).
    """
    change, turn = np.zeros((6, 6)), T_new_old[:3, :3]
    change[:3, :3] = change[3:, 3:] = turn
    change[:3, 3:] = skew(T_new_old[:3, 3]) @ turn
    return np.asarray(change @ offset @ change.T)


def _reached(voxel_map: VoxelMap, transform: FloatArray) -> NDArray[np.int32]:
    """Voxels into which something may come, each once."""
    size = voxel_map.config.voxel_size
    centers = transform_points(transform, (voxel_map.voxels()[0] + 0.5) * size)
    low = np.floor(centers / size - 0.5).astype(np.int32)
    corners = np.stack(np.meshgrid(*[[0, 1]] * 3), axis=-1).reshape(-1, 3)
    around = (low[:, None] + corners[None].astype(np.int32)).reshape(-1, 3)
    return np.asarray(np.unique(around, axis=0), np.int32)


def _moved_surfaces(voxel_map: VoxelMap, transform: FloatArray) -> VoxelStates:
    size, turn = voxel_map.config.voxel_size, transform[:3, :3]
    old, means, covariances = voxel_map.gaussians(relative=True)
    odds = voxel_map.log_odds((old + 0.5) * size)
    means, covariances = transform_points(transform, means), turn @ covariances @ turn.T
    indices = np.floor(means / size).astype(np.int32)
    order = np.argsort(np.linalg.det(covariances), kind="stable")
    _, first = np.unique(indices[order], axis=0, return_index=True)
    chosen = order[first]
    surface = np.ones(len(chosen), np.bool_)
    information = information_of(indices[chosen], surface, means[chosen], covariances[chosen], size)
    quanta = np.rint(odds[chosen] / LOG_ODDS_QUANTUM).astype(np.int32)
    return VoxelStates(indices[chosen], surface, quanta, information)
