"""The rover in a cave that it once did not leave its start in, and a robot that nobody here made.

As `infomap explore` runs them: localized by their own images, scans fused while they move.
"""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from infomap_ros.cli.command_options import with_settings
from infomap_ros.exploration.loop import EndReason
from infomap_ros.simulation.exploring.exploration_run import ExplorationOptions, ExplorationRun
from infomap_ros.simulation.robots.robot_file import RobotFile

QUICK = (
    "simulator.camera.supersampling=1",
    "simulator.camera.multisampling=0",
    "simulator.camera.shadow_map=1024",
    "simulator.camera.width=320",
    "simulator.camera.height=240",
)


@pytest.mark.parametrize(
    ("robot", "world", "seed", "views", "distance", "coverage"),
    [("", "cave", 2, 6, 1.0, 0.75), ("ur5_on_base", "office", 5, 5, 0.5, 0.6)],
)
def test_it_moves_sees_most_touches_nothing_and_is_as_sure_as_it_says(
    robot: str, world: str, seed: int, views: int, distance: float, coverage: float, tmp_path: Path
) -> None:
    known = RobotFile.read(robot).settings if robot else []
    budget = (f"world.name={world}", f"world.seed={seed}", f"task.max_views={views}")
    small = "world.size=5.5"
    run = ExplorationRun(
        with_settings(ExplorationOptions(), [*known, *budget, small, *QUICK]), tmp_path
    )
    ending = run.run()
    summary = run.write_results(ending)
    run.close()
    assert ending.reason in (EndReason.BUDGET_SPENT, EndReason.DONE), ending.detail
    assert float(str(summary["distance"])) > distance
    assert summary["contacts"] == 0, summary.get("touched")
    assert float(str(summary["true_coverage"])) > coverage
    assert float(str(summary["within_2_sigma"])) > 0.9
    told = [json.loads(line) for line in (tmp_path / "exploration.jsonl").open()]
    looks = [entry for entry in told if entry.get("action") == "look"]
    assert [look["outcome"] for look in looks] == [""] * len(looks)
    dropped = str(summary.get("ruled_out", ""))
    assert "cannot drive" not in dropped and "folding" not in dropped
