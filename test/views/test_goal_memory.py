"""Unreachable views are remembered until the map changes."""

from __future__ import annotations

import numpy as np
import pytest

from infomap_ros.errors import InvalidInputError
from infomap_ros.mapping import VoxelMap
from infomap_ros.views.decision import GoalMemory

from .rooms import CAMERA, box_points, facing, seen_room

ROOM = (6.0, 4.0, 2.5)
GOAL = facing(0.3, (3.0, 2.0, 1.2))
REASON = "base path: too steep"


@pytest.fixture
def voxel_map() -> VoxelMap:
    return seen_room([facing(angle, (1.5, 2.0, 1.2)) for angle in (-0.5, 0.0, 0.5)], ROOM)


@pytest.fixture
def memory(voxel_map: VoxelMap) -> GoalMemory:
    memory = GoalMemory()
    memory.remember(GOAL, REASON, voxel_map)
    return memory


def look(voxel_map: VoxelMap, pose: np.ndarray) -> None:
    for _ in range(2):
        voxel_map.integrate(box_points(CAMERA, pose, ROOM), pose, camera=CAMERA)


def test_same_view_is_ruled_out_with_the_reason(memory: GoalMemory, voxel_map: VoxelMap) -> None:
    near = facing(0.4, (3.1, 2.05, 1.2))
    reasons = memory.reasons_against(np.stack([GOAL, near]), voxel_map)
    assert all(REASON in reason for reason in reasons)


def test_other_views_are_not(memory: GoalMemory, voxel_map: VoxelMap) -> None:
    elsewhere, turned = facing(0.3, (3.5, 2.0, 1.2)), facing(1.3, (3.0, 2.0, 1.2))
    assert memory.reasons_against(np.stack([elsewhere, turned]), voxel_map) == ["", ""]


def test_goal_is_tried_again_when_the_map_around_it_changes(
    memory: GoalMemory, voxel_map: VoxelMap
) -> None:
    look(voxel_map, facing(np.pi / 2, (3.0, 0.5, 0.6)))
    assert memory.reasons_against(GOAL[None], voxel_map) == [""]
    assert len(memory) == 0


def test_change_far_away_does_not_matter(memory: GoalMemory, voxel_map: VoxelMap) -> None:
    before = voxel_map.known_voxels
    look(voxel_map, facing(np.pi, (1.0, 2.0, 1.2)))
    assert before < voxel_map.known_voxels < 1.15 * before
    assert memory.reasons_against(GOAL[None], voxel_map) != [""]


def test_large_change_anywhere_does(memory: GoalMemory, voxel_map: VoxelMap) -> None:
    for angle in (2.0, 3.0, 4.0):
        look(voxel_map, facing(angle, (1.5, 2.0, 1.2)))
    assert memory.reasons_against(GOAL[None], voxel_map) == [""]


def test_evidence_that_only_grows_is_no_change(memory: GoalMemory, voxel_map: VoxelMap) -> None:
    look(voxel_map, facing(0.0, (1.5, 2.0, 1.2)))
    assert memory.reasons_against(GOAL[None], voxel_map) != [""]


def test_what_is_no_pose_is_refused(voxel_map: VoxelMap) -> None:
    with pytest.raises(InvalidInputError, match="T_map_camera"):
        GoalMemory().remember(np.zeros((4, 4)), REASON, voxel_map)
