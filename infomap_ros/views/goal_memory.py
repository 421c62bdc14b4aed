"""Views that could not be reached, until the map around them changes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from infomap_ros.geometry.config import check_config, setting
from infomap_ros.geometry.transforms import FloatArray, check_transform
from infomap_ros.mapping import VoxelMap
from infomap_ros.mapping.voxels.window import UNKNOWN_QUANTA


@dataclass(frozen=True)
class GoalMemoryConfig:
    """Configuration of `GoalMemory`.

    Raises:
        ConfigError: a value is out of its range.
    """

    same_distance: float = setting(
        0.2, "Views nearer than this to a remembered one, and", unit="m", low=0.0, high=10.0
    )
    same_angle: float = setting(
        0.35, "turned by less than this, count as the same.", unit="rad", low=0.0, high=3.15
    )
    around: ClassVar[float] = 0.8
    """The map so far around a remembered view must change for the view to be tried again [m]."""
    local_change: ClassVar[float] = 0.02
    """Share of the voxels around it whose state must change for that."""
    overall_change: ClassVar[float] = 0.15
    """Share by which the number of known voxels must grow or shrink for all views to be tried
    again: the way may lead elsewhere.
    """

    def __post_init__(self) -> None:
        check_config(self)


@dataclass(frozen=True, eq=False)
class _Goal:
    pose: FloatArray
    reason: str
    signs: np.ndarray[tuple[int, int, int], np.dtype[np.int8]]
    known_voxels: int


class GoalMemory:
    """Remembers unreachable views, so that they are not tried again and again."""

    def __init__(self, config: GoalMemoryConfig | None = None) -> None:
        self.config = config or GoalMemoryConfig()
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
        least_cosine = float(np.cos(self.config.same_angle))
        for goal in self._goals:
            gaps = np.linalg.norm(poses[:, :3, 3] - goal.pose[:3, 3], axis=1)
            near = gaps <= self.config.same_distance
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
            if abs(known - goal.known_voxels)
            <= self.config.overall_change * max(goal.known_voxels, 1)
            and self._share_changed(goal, voxel_map) <= self.config.local_change
        ]

    def _share_changed(self, goal: _Goal, voxel_map: VoxelMap) -> float:
        return float(np.mean(self._signs(goal.pose, voxel_map) != goal.signs))

    def _signs(
        self, pose: FloatArray, voxel_map: VoxelMap
    ) -> np.ndarray[tuple[int, int, int], np.dtype[np.int8]]:
        """Unknown 0, rather empty -1, rather occupied 1, of the voxels around a view."""
        middle = pose[:3, 3]
        window = voxel_map.window(middle - self.config.around, middle + self.config.around)
        signs = np.where(window.quanta > 0, 1, -1).astype(np.int8)
        signs[window.quanta == UNKNOWN_QUANTA] = 0
        return signs
