"""Nodes that are killed and started again lose neither the map nor the mission."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from infomap_ros.mapping import VoxelMap
from infomap_ros.nodes.live.live_exploration import LiveExploration

TASK = {
    "task.region_low": [-2.5, -2.5, -0.5],
    "task.region_high": [2.5, 2.5, 1.2],
    "task.max_views": 8,
    "task.known_fraction": 1.0,
}
PARAMETERS: dict[str, dict[str, Any]] = {
    "simulator": {
        "world": "office",
        "camera.width": 160,
        "camera.height": 120,
        "camera.supersampling": 1,
        "images_while_moving": False,
    },
    "map_fusion": {"voxel_size": 0.1, "autosave_period": 1.0},
    "next_best_view": {
        **TASK,
        "choice.candidates.candidates": 150,
        "choice.selection.refined": 10,
        "arm_views": 50,
        "reaching.postures": 3000,
        "reaching.collision.tolerance": 0.03,
        "start_clearance": 1.2,
    },
    "explorer": TASK,
}
NODES = ("stereo_range", "map_fusion", "next_best_view", "explorer", "simulator")
TIMEOUT = 300.0  # [s]; kernels may have to be compiled


def records_of(run: LiveExploration, kind: str) -> list[dict[str, Any]]:
    lines = run.log_file.read_text(encoding="utf-8").splitlines()
    return [entry for entry in map(json.loads, lines) if entry["kind"] == kind]


def test_killed_nodes_lose_neither_map_nor_mission(tmp_path: Path) -> None:
    with LiveExploration(tmp_path, PARAMETERS, localized=False) as run:

        def views() -> int:
            return int(run.figures.get("views", "0"))

        run.start()
        run.spin_until(lambda: views() >= 2 and run.map_file.exists(), "two views", TIMEOUT)
        saved = VoxelMap.load(run.map_file).known_voxels
        for name in NODES:
            before = views()
            if name == "map_fusion":  # what it has not saved yet is lost with it
                run.call("map_fusion/save")
            run.kill_node(name)
            run.spin_until(lambda n=before: views() > n, f"views after {name}", TIMEOUT)
        run.follow(lambda: None, TIMEOUT)
        run.call("map_fusion/save")
    assert run.figures["state"] == "ended: budget spent", run.figures["last reason"]
    assert views() == TASK["task.max_views"]
    counts = [entry["views"] for entry in records_of(run, "progress")]
    assert counts == sorted(counts)
    known = [entry["known_voxels"] for entry in records_of(run, "progress")]
    assert all(after >= 0.9 * max(known[:i]) for i, after in enumerate(known) if i)
    assert VoxelMap.load(run.map_file).known_voxels >= saved
    assert len(records_of(run, "start")) == 2
