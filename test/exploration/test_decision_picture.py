"""A decision as a picture for documents."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from infomap_ros.errors import InvalidInputError
from infomap_ros.exploration.records.recorded_run import RecordedRun, read_run
from infomap_ros.exploration.reports.decision_picture import draw_decision
from infomap_ros.mapping import VoxelMap

from .made_up_run import made_up_map, write_log

BASE_PATH = (0, 94, 213)  # BGR


@pytest.fixture(scope="module")
def voxel_map() -> VoxelMap:
    return made_up_map(count=6, voxel_size=0.1)


@pytest.fixture
def run(tmp_path: Path) -> RecordedRun:
    return read_run(write_log(tmp_path / "run.jsonl"))


def drawn(run: RecordedRun, step: int, voxel_map: VoxelMap, path: Path) -> np.ndarray:
    draw_decision(run, step, voxel_map, path)
    image = cv2.imread(str(path))
    assert image is not None
    return image


def count(image: np.ndarray, color: tuple[int, int, int]) -> int:
    return int((np.abs(image.astype(int) - color).max(axis=2) < 4).sum())


def test_paths_until_the_decision_are_drawn(
    run: RecordedRun, voxel_map: VoxelMap, tmp_path: Path
) -> None:
    pixels = [count(drawn(run, step, voxel_map, tmp_path / "a.png"), BASE_PATH) for step in (0, 4)]
    assert pixels[1] > 3 * pixels[0] > 0  # before the first decision: the legend


def test_a_decision_without_a_view_is_drawn(
    run: RecordedRun, voxel_map: VoxelMap, tmp_path: Path
) -> None:
    last = len(run.steps) - 1
    chosen, none = (
        drawn(run, step, voxel_map, tmp_path / f"{step}.png") for step in (last - 1, last)
    )
    dark = (39, 33, 28)  # BGR
    assert count(none, dark) < count(chosen, dark)


def test_a_step_that_is_none_is_refused(
    run: RecordedRun, voxel_map: VoxelMap, tmp_path: Path
) -> None:
    with pytest.raises(InvalidInputError, match="step: is 13, but the run has 13 decisions"):
        draw_decision(run, 13, voxel_map, tmp_path / "a.png")


def test_a_map_without_surface_is_refused(run: RecordedRun, tmp_path: Path) -> None:
    with pytest.raises(InvalidInputError, match="has no surface"):
        draw_decision(run, 0, VoxelMap(), tmp_path / "a.png")
