"""Run logs are read back whole, and what is wrong with one is said with its line."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from infomap_ros.errors import RunLogError
from infomap_ros.exploration.records.recorded_run import read_run
from infomap_ros.exploration.records.run_log import Decision, Motion, Progress, RunLogFile

from .made_up_run import CAMERA, entries, write_log


def written(path: Path, found: list[Any]) -> Path:
    path.write_text("".join(json.dumps(entry) + "\n" for entry in found), encoding="utf-8")
    return path


def test_every_entry_is_read(tmp_path: Path) -> None:
    told = entries()
    run = read_run(write_log(tmp_path / "run.jsonl"))
    assert run.problems == ()
    assert len(run.records) == len(told)
    kinds = [type(record).__name__.lower() for record in run.records]
    assert kinds == [entry["kind"] for entry in told]
    assert [record.time for record in run.records] == [entry["t"] for entry in told]
    assert run.start.camera == CAMERA
    assert run.end is not None
    assert run.end.reason == "done"


def test_a_decision_keeps_its_numbers(tmp_path: Path) -> None:
    told = next(entry for entry in entries() if entry["kind"] == "decision")
    decision = read_run(write_log(tmp_path / "run.jsonl")).of(Decision)[0]
    assert decision.pose is not None
    np.testing.assert_array_equal(decision.pose.reshape(-1), told["pose"])
    assert decision.terms == told["terms"]
    for candidate, entry in zip(decision.candidates, told["candidates"], strict=True):
        np.testing.assert_array_equal(candidate.position, entry["position"])
        np.testing.assert_allclose(candidate.direction, entry["direction"], atol=1e-12)
        assert candidate.rejection == entry["rejection"]
        assert np.isnan(candidate.rating) == (entry["rating"] is None)


def test_what_the_log_file_writes_is_read(tmp_path: Path) -> None:
    path = tmp_path / "run.jsonl"
    log = RunLogFile(path)
    for entry in entries(count=3, candidates=4):
        log.write(entry["kind"], **{k: v for k, v in entry.items() if k not in ("t", "kind")})
    run = read_run(path)
    assert run.problems == ()
    assert len(run.of(Decision)) == 4


@pytest.mark.parametrize("cut", [1, 40, 3000])
def test_a_line_that_was_cut_off_is_named_and_the_whole_ones_are_used(
    tmp_path: Path, cut: int
) -> None:
    path = written(tmp_path / "run.jsonl", entries()[:3])
    size = path.stat().st_size
    data = path.read_bytes()[:-1]
    path.write_bytes(data[: size - 1 - cut])
    run = read_run(path)
    assert run.problems == ("line 3: is cut off",)
    assert [type(record).__name__ for record in run.records] == ["Start", "Progress"]
    assert run.end is None


def test_an_interrupted_run_that_was_continued_has_its_last_start(tmp_path: Path) -> None:
    told = entries()
    again = {**told[0], "t": 500.0, "strategy": "random"}
    run = read_run(written(tmp_path / "run.jsonl", [*told, again, *told[1:4]]))
    assert run.start.strategy == "random"
    assert run.end is None
    assert len(run.of(Progress)) == len([e for e in told if e["kind"] == "progress"]) + 1


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        (b"", "it is empty"),
        (b"\x89PNG\r\n\x1a\n\x00\x00", "line 1: is not text"),
        (b"stamp x y z\n1 2 3 4\n", "line 1: is not JSON"),
        (b"[1, 2]\n", "line 1: is not a JSON object"),
        (b'{"frames": 3}\n', "line 1: kind None is not one of start,"),
        (b'{"t": 0, "kind": "message", "text": "hello"}\n', "line 1: its kind is not 'start'"),
        (b'{"t": 0, "kind": "start", "task": 3}\n', "line 1: 'task'"),
    ],
)
def test_a_foreign_file_is_refused(tmp_path: Path, content: bytes, reason: str) -> None:
    path = tmp_path / "foreign.jsonl"
    path.write_bytes(content)
    with pytest.raises(RunLogError, match=f"foreign.jsonl is not a run log: {reason}"):
        read_run(path)


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(RunLogError, match=r"none\.jsonl cannot be read"):
        read_run(tmp_path / "none.jsonl")


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({"kind": "decission"}, "kind 'decission' is not one of"),
        ({"pose": [1.0] * 15}, "'pose' is .*, expected 16 finite numbers"),
        ({"pose": "ahead"}, "'pose' is 'ahead', expected numbers"),
        ({"view": -1}, "'view' is -1, expected a whole number"),
        ({"t": "now"}, "'t' is 'now', expected a number"),
        ({"terms": {"risk": "high"}}, "'risk' is 'high', expected a number"),
        ({"candidates": {}}, "'candidates' is not a list"),
        ({"candidates": [7]}, "a candidate is not a JSON object"),
        (
            {"candidates": [{"position": [0, 0, 0], "direction": [0, 0, 0]}]},
            "'direction' of a candidate has no length",
        ),
    ],
)
def test_a_line_that_contradicts_itself_is_named(
    tmp_path: Path, change: dict[str, Any], reason: str
) -> None:
    told = entries()
    told[2] = {**told[2], **change}
    run = read_run(written(tmp_path / "run.jsonl", told))
    assert len(run.records) == len(told) - 1
    (problem,) = run.problems
    assert problem.startswith("line 3: ")
    assert re.search(reason, problem)


def test_each_step_says_what_came_of_it(tmp_path: Path) -> None:
    steps = read_run(write_log(tmp_path / "run.jsonl")).steps
    outcomes = [step.outcome for step in steps]
    expected = ["taken"] * 12 + ["no view"]
    expected[5] = "drive: blocked after 0.4 m"
    assert outcomes == expected
    assert [len(step.motions) for step in steps] == [3] * 5 + [1] + [3] * 6 + [0]


def test_counts_of_a_log_that_lists_some_candidates_only_are_taken_from_it(tmp_path: Path) -> None:
    told = entries(count=1, candidates=10)
    told[2] |= {"rejections": {"in collision: wheel": 700, "not free": 30}, "considered": 1000}
    listed, counted = read_run(written(tmp_path / "run.jsonl", told)).of(Decision)
    assert listed.considered == 1000
    assert listed.rejections == {"in collision: wheel": 700, "not free": 30}
    assert counted.considered == 10
    rejected = [c["rejection"] for c in told[-2]["candidates"] if c["rejection"]]
    assert counted.rejections == {reason: rejected.count(reason) for reason in rejected}


def test_paths_are_kept(tmp_path: Path) -> None:
    told = [entry for entry in entries() if entry["kind"] == "motion"]
    motions = read_run(write_log(tmp_path / "run.jsonl")).of(Motion)
    for motion, entry in zip(motions, told, strict=True):
        np.testing.assert_array_equal(motion.path, np.reshape(entry["path"], (-1, 3)))
