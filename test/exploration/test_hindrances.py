"""What stood in a run's way, counted by hand in a log that was made up."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from infomap_ros.exploration.records.recorded_run import read_run
from infomap_ros.exploration.records.run_figures import hindrance_figures
from infomap_ros.exploration.records.run_log import RunLogFile

START = {
    "task": {}, "robot": "rover", "world": "office 1", "strategy": "random", "voxel_size": 0.05,
    "max_range": 4.0,
}  # fmt: skip


def decision(view: int, rejections: dict[str, int]) -> dict[str, object]:
    return {
        "view": view, "pose": np.eye(4).ravel(), "base": (0.0, 0.0, 0.0), "strategy": "random",
        "rating": 1.0, "terms": {}, "reason": "", "seconds": {}, "considered": 9,
        "candidates": [], "position_sigma": 0.01, "rejections": rejections,
    }  # fmt: skip


def test_reasons_of_all_decisions_are_counted(tmp_path: Path) -> None:
    log = RunLogFile(tmp_path / "run.jsonl")
    log.write("start", **START)
    log.write("decision", **decision(1, {"gripper touches a wall at (0.10, 0.20)": 3, "far": 1}))
    log.write("decision", **decision(2, {"gripper touches a wall at (1.50, 0.20)": 4, "near": 2}))
    log.write("message", text="drive: broken off: step of 0.05 m", level="info")
    log.write("message", text="drive: broken off: step of 0.07 m", level="info")
    found = hindrance_figures(read_run(tmp_path / "run.jsonl"))
    assert found == {
        "ruled_out": "gripper touches a wall at (0.10, 0.20) (7); near (2); far (1)",
        "went_wrong": "drive: broken off: step of 0.05 m (2)",
    }


def test_a_run_that_nothing_hindered_has_none(tmp_path: Path) -> None:
    log = RunLogFile(tmp_path / "run.jsonl")
    log.write("start", **START)
    log.write("decision", **decision(1, {}))
    assert hindrance_figures(read_run(tmp_path / "run.jsonl")) == {}
