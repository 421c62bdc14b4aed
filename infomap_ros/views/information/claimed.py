"""What teammates are about to see, voxel by voxel, so that it is counted once.

The view that a teammate is heading for is expected to tell something of each voxel that it sees,
by the same sensor model as one's own views. Of what a view tells of a voxel, that much is the
teammate's.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import reduce
from typing import Protocol

import numpy as np

from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.views.information.voxel_gains import VoxelGains
from infomap_ros.views.situation import Situation, Teammate


class GainsSource(Protocol):
    """Tells which voxels views inform, and by how much."""

    def gains(self, situation: Situation, poses: FloatArray) -> list[VoxelGains]:
        """Of each view ``T_map_camera``, shape (M, 4, 4)."""


def claimed_gains(source: GainsSource, situation: Situation) -> VoxelGains | None:
    """What all teammates together are about to be told; None where none has a goal."""
    parts = [
        source.gains(_as_seen_by(mate, situation), mate.goal[None])[0]
        for mate in situation.teammates
        if mate.goal is not None
    ]
    return reduce(VoxelGains.joined, parts) if parts else None


def shares_left(
    source: GainsSource, situation: Situation, poses: FloatArray, claimed: VoxelGains | None
) -> FloatArray:
    """Share of the information of views that teammates leave to them.

    Args:
        source: of what views tell.
        situation: with the teammates.
        poses: ``T_map_camera`` of the views, shape (M, 4, 4).
        claimed: what the teammates are about to be told.

    Returns:
        Shape (M,), within [0, 1]; 1 for a view that tells nothing.
    """
    left = np.ones(len(poses))
    if claimed is None:
        return left
    near = np.flatnonzero(_may_overlap(situation.teammates, situation.max_range, poses))
    for index, gains in zip(near, source.gains(situation, poses[near]), strict=True):
        if gains.total > 0.0:
            left[index] = gains.beyond(claimed) / gains.total
    return np.clip(left, 0.0, 1.0)


def _as_seen_by(mate: Teammate, situation: Situation) -> Situation:
    """The situation with the camera and the range of a teammate."""
    return replace(
        situation, camera=mate.camera or situation.camera, max_range=float(mate.max_range)
    )


def _may_overlap(mates: Sequence[Teammate], max_range: float, poses: FloatArray) -> np.ndarray:
    """Which views are near enough to a teammate's next one to see the same."""
    near = np.zeros(len(poses), np.bool_)
    for mate in mates:
        if mate.goal is not None:
            away = np.linalg.norm(poses[:, :3, 3] - mate.goal[:3, 3], axis=1)
            near |= away < max_range + mate.max_range
    return near
