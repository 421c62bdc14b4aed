"""What the time of a run went into, from logs with known times."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from infomap_ros.exploration.records.recorded_run import RecordedRun, read_run
from infomap_ros.exploration.records.run_log import RunLogFile
from infomap_ros.exploration.reports.report import activities, time_line

# seconds that each entry takes by the wall and by the robot, kind of the entry
ENTRIES = (
    (1.0, 0.5, "look", ""),
    (10.0, 0.0, "decision", ""),
    (4.0, 2.0, "arm", ""),
    (20.0, 10.0, "drive", "blocked"),
    (2.0, 1.0, "look", ""),
    (5.0, 0.0, "decision", ""),
    (3.0, 1.5, "arm", ""),
)


def run_of(
    path: Path, entries: Sequence[tuple[float, float, str, str]] = ENTRIES, told: bool = True
) -> RecordedRun:
    """The run of a log; `told`: whether it tells the robot's clock, which begins at 100 s."""
    now = [0.0, 100.0]
    robot_clock = (lambda: now[1]) if told else None
    log = RunLogFile(path, clock=lambda: now[0], robot_clock=robot_clock)
    log.write("start", task={}, world="office 1")
    for view, (wall, robot, kind, outcome) in enumerate(entries):
        now[0] += wall
        now[1] += robot
        if kind == "decision":
            log.write("decision", view=view, pose=np.eye(4).ravel(), candidates=[])
        else:
            log.write("motion", action=kind, outcome=outcome, path=[])
    now[0] += 7.0
    log.write("end", reason="done", detail="")
    return read_run(path)


def test_each_activity_lasts_since_the_one_before(tmp_path: Path) -> None:
    done = activities(run_of(tmp_path / "run.jsonl"))
    assert [each.kind for each in done] == [
        *("look", "choose", "arm", "drive", "look", "choose", "arm"),
    ]
    assert [each.step for each in done] == [None, 0, 0, 0, 0, 1, 1]
    assert [each.seconds for each in done] == [row[0] for row in ENTRIES]
    assert [each.clock_seconds for each in done] == [row[1] for row in ENTRIES]
    assert [each.problem for each in done if each.problem] == ["blocked"]


def test_the_pause_before_a_run_was_continued_is_nobodys(tmp_path: Path) -> None:
    path = tmp_path / "run.jsonl"
    run_of(path, ENTRIES[:3])
    now = [50.0]
    log = RunLogFile(path, append=True, clock=lambda: now[0])
    now[0] += 30.0
    log.write("start", task={})
    now[0] += 2.0
    log.write("motion", action="look", outcome="", path=[])
    done = activities(read_run(path))
    assert [each.seconds for each in done] == [1.0, 10.0, 4.0, 2.0]


def test_both_clocks_are_drawn_where_they_differ(tmp_path: Path) -> None:
    drawn = time_line(run_of(tmp_path / "run.jsonl"))
    lanes = re.findall(r'<div class="lane".*?</div>', drawn)
    grown = [[float(grow) for grow in re.findall(r"flex-grow:([0-9.]+)", lane)] for lane in lanes]
    assert grown == [[row[0] for row in ENTRIES], [row[1] for row in ENTRIES if row[1] > 0.0]]
    assert "wall time" in drawn
    assert "simulated time" in drawn
    assert "blocked" in drawn


@pytest.mark.parametrize("told", [False, True])
def test_clocks_that_agree_are_one(tmp_path: Path, told: bool) -> None:
    alike = [(wall, wall, kind, outcome) for wall, _, kind, outcome in ENTRIES]
    drawn = time_line(run_of(tmp_path / "run.jsonl", alike, told))
    assert drawn.count('class="lane"') == 1
    assert "simulated" not in drawn


def test_a_run_of_nothing_has_no_time_line(tmp_path: Path) -> None:
    assert time_line(run_of(tmp_path / "run.jsonl", ())) == ""
