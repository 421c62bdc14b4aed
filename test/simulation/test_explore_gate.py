"""How the gate of explorations judges rows and goes on, without the explorations."""

from __future__ import annotations

import importlib.util
import json
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

SCRIPT = Path(__file__).resolve().parents[2] / "benchmarks" / "explore_gate.py"
FIGURES = {
    "end": "done",
    "detail": "enough | known",
    "views": 28,
    "distance": 9.1,
    "true_coverage": 0.95,
    "contacts": 0,
    "within_1_sigma": 0.70,
    "within_2_sigma": 0.94,
    "within_3_sigma": 0.98,
    "pose_nees": 0.9,
}
ROW = FIGURES | {
    "run": "cave:2",
    "software": "0.1.0 (abc)",
    "date": "2026-11-25",
    "settings": [],
    "wall_seconds": 300.0,
    "cannot_drive": 0.04,
    "problem": "",
}


@pytest.fixture
def gate(monkeypatch: pytest.MonkeyPatch) -> Any:
    monkeypatch.syspath_prepend(str(SCRIPT.parent))
    spec = importlib.util.spec_from_file_location("explore_gate", SCRIPT)
    module = importlib.util.module_from_spec(spec)
    monkeypatch.setitem(sys.modules, "explore_gate", module)  # for its dataclasses
    spec.loader.exec_module(module)
    return module


def test_a_run_at_its_thresholds_is_good_enough(gate: Any) -> None:
    assert gate.shortcomings(ROW, 28) == []


@pytest.mark.parametrize(
    ("figure", "value", "said"),
    [
        ("true_coverage", 0.949, "true coverage 94.9% < 95%"),
        ("distance", 0.0, "did not drive"),
        ("contacts", 3, "3 contacts"),
        ("cannot_drive", 0.05, "cannot drive: 5.0% of candidates >= 5%"),
        ("cannot_drive", None, "cannot drive: nan% of candidates >= 5%"),
        ("views", 29, "29 views > 28"),
        ("within_2_sigma", 0.89, "within 2 sigma 89.0% < 90%"),
        ("within_3_sigma", None, "within 3 sigma nan% < 96%"),
        ("problem", "took longer than 40 min", "took longer than 40 min"),
    ],
)
def test_each_figure_that_falls_short_is_named(
    gate: Any, figure: str, value: object, said: str
) -> None:
    assert gate.shortcomings(ROW | {figure: value}, 28) == [said]


def test_views_of_other_robots_are_not_judged(gate: Any) -> None:
    assert gate.shortcomings(ROW | {"views": 40}, gate.GateRun.of("tiago").most_views) == []


def test_the_mean_is_that_of_runs_that_ended(gate: Any) -> None:
    broken = {"problem": "was killed by signal 9: -", "run": "mars:1"}
    other = ROW | {"within_1_sigma": 0.74}
    assert gate.mean_shortcomings([ROW, other, broken]) == []
    found = gate.mean_shortcomings([other, ROW | {"within_1_sigma": 0.78}, broken])
    assert found == ["mean within 1 sigma 76.0% is more than 5 points from 68%"]
    assert gate.mean_shortcomings([broken]) == ["no run came to its end"]


def test_refusals_count_over_all_decisions(gate: Any) -> None:
    stuck = "the base cannot drive: no pose next to it is safe"
    counts = [
        (100, {f"{stuck}: 5 of 23": 3, "too little information": 50}),
        (300, {f"the ground below is a hole; {stuck}": 9}),
    ]
    decisions = [SimpleNamespace(considered=n, rejections=reasons) for n, reasons in counts]
    steps = [SimpleNamespace(decision=decision) for decision in decisions]
    assert gate.cannot_drive_share(SimpleNamespace(steps=steps)) == pytest.approx(0.03)
    assert gate.cannot_drive_share(SimpleNamespace(steps=[])) is None


def test_names_are_worlds_with_seeds_or_robots(gate: Any) -> None:
    assert "task.max_views=71" in gate.GateRun.of("mars:1").settings
    assert not any("max_views" in one for one in gate.GateRun.of("mars:7").settings)
    assert gate.GateRun.of("pr2").robot == "pr2"
    with pytest.raises(ValueError, match="'moon:1' is none of"):
        gate.GateRun.of("moon:1")


def test_a_series_goes_on_where_it_was(
    gate: Any,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    explored: list[str] = []

    def explore(run: Any, out: Path, settings: list[str], *_: object) -> dict[str, object]:
        explored.append(run.name)
        run.folder(out).mkdir(exist_ok=True)
        row = {name: value for name, value in ROW.items() if name not in FIGURES}
        row |= {"run": run.name, "settings": [*run.settings, *settings]}
        breaks = run.name == "tiago" and explored.count("tiago") == 1
        return row | ({"problem": "took longer than 40 min"} if breaks else FIGURES)

    monkeypatch.setattr(gate, "explore", explore)
    command = ["explore_gate", "--only", "cave:2", "tiago", "--jobs", "1", "--out", str(tmp_path)]
    monkeypatch.setattr("sys.argv", command)
    assert gate.main() == 1
    assert "tiago: took longer than 40 min" in capsys.readouterr().out
    assert gate.main() == 0
    assert explored == ["cave:2", "tiago", "tiago"]
    printed = capsys.readouterr().out.splitlines()
    assert [json.loads(line)["run"] for line in printed[:2]] == ["cave:2", "tiago"]
    assert "| cave 2 | done: enough / known | 28 | 9.1 m |" in (tmp_path / "table.md").read_text()

    monkeypatch.setattr("sys.argv", [*command, "--set", "task.max_views=2"])
    assert gate.main() == 0
    assert explored[3:] == ["cave:2", "tiago"]


def test_a_child_that_fails_says_why(gate: Any, tmp_path: Path) -> None:
    children, output = gate.Children(), tmp_path / "output.txt"
    failing = ["sh", "-c", "echo at work; echo no world; exit 3"]
    assert children.run(failing, output, 10.0) == "ended with status 3: no world"
    assert "took longer" in children.run(["sleep", "10"], output, 0.05)
    children.end()
    assert children.run(["true"], output, 10.0) == "not begun"
