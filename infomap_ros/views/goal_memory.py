"""Views that could not be reached, until the map around them changes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from infomap_ros.geometry.transforms import FloatArray, check_transform
from infomap_ros.mapping import VoxelMap
from infomap_ros.mapping.voxels.window import UNKNOWN_QUANTA

_SAME_DISTANCE, _SAME_ANGLE = 0.2, 0.35
# [m], [rad]: views nearer to a remembered one, and turned by less, are the same
_AROUND = 0.8  # [m] about a remembered view, where the map must change for it to be tried again
_LOCAL_CHANGE = 0.02  # share of the voxels there whose state must change for that
_OVERALL_CHANGE = 0.15
# share by which the number of known voxels must change for all to be tried again: the way may lead
# elsewhere


@dataclass(frozen=True, eq=False)
class _Goal:
    pose: FloatArray
    reason: str
    signs: np.ndarray[tuple[int, int, int], np.dtype[np.int8]]
    known_voxels: int


class GoalMemory:
    """Remembers unreachable views, so that they are not tried again and again."""

    def __init__(self) -> None:
        self._goals: list[_Goal] = []

    def __len__(self) -> int:
        return len(self._goals)

    def remember(self, T_map_camera: FloatArray, reason: str, voxel_map: VoxelMap) -> None:
        """Note that a view, shape (4, 4), cannot be reached in the map as it is, and why."""
        pose = check_transform(T_map_camera, "T_map_camera")
        signs = self._signs(pose, voxel_map)
        self._goals.append(_Goal(pose, reason, signs, voxel_map.known_voxels))

    def reasons_against(self, poses: FloatArray, voxel_map: VoxelMap) -> list[str]:
        """Why not to try views, shape (M, 4, 4), again: "" or the reason, one each.

        Goals around which the map has changed are forgotten first.
        """
        self._forget_changed(voxel_map)
        reasons = [""] * len(poses)
        least_cosine = float(np.cos(_SAME_ANGLE))
        for goal in self._goals:
            gaps = np.linalg.norm(poses[:, :3, 3] - goal.pose[:3, 3], axis=1)
            near = gaps <= _SAME_DISTANCE
            # trace(R^T Q) = 1 + 2 cos(angle between the rotations)
            traces = np.einsum("mij,ij->m", poses[:, :3, :3], goal.pose[:3, :3])
            for index in np.flatnonzero(near & (0.5 * (traces - 1.0) >= least_cosine)):
                reasons[index] = f"unreachable before: {goal.reason}"
        return reasons

    def _forget_changed(self, voxel_map: VoxelMap) -> None:
        if not self._goals:
            return
        known = voxel_map.known_voxels
        self._goals = [
            goal
            for goal in self._goals
            if abs(known - goal.known_voxels) <= _OVERALL_CHANGE * max(goal.known_voxels, 1)
            and self._share_changed(goal, voxel_map) <= _LOCAL_CHANGE
        ]

    def _share_changed(self, goal: _Goal, voxel_map: VoxelMap) -> float:
        return float(np.mean(self._signs(goal.pose, voxel_map) != goal.signs))

    def _signs(
        self, pose: FloatArray, voxel_map: VoxelMap
    ) -> np.ndarray[tuple[int, int, int], np.dtype[np.int8]]:
        """Unknown 0, rather empty -1, rather occupied 1, of the voxels around a view."""
        middle = pose[:3, 3]
        window = voxel_map.window(middle - _AROUND, middle + _AROUND)
        signs = np.where(window.quanta > 0, 1, -1).astype(np.int8)
        signs[window.quanta == UNKNOWN_QUANTA] = 0
        return signs
