"""The table of worlds that the node graph explored, without the explorations."""

from __future__ import annotations

import importlib.util
import json
from importlib.metadata import version
from pathlib import Path
from typing import Any

import pytest
from rich.console import Console

from infomap_ros.errors import ProcessError
from infomap_ros.nodes.live.demo import DemoConfig

SCRIPT = Path(__file__).resolve().parent.parent.parent / "benchmarks" / "live_worlds.py"
FIGURES = {
    "end": "done",
    "detail": "enough | known",
    "views": 12.0,
    "distance [m]": 7.25,
    "simulated_seconds": 301.4,
    "known fraction": 0.961,
    "true_coverage": 0.9523,
    "within_1_sigma": 0.68,
    "within_2_sigma": 0.95,
    "within_3_sigma": None,
    "pose_nees": 1.042,
    "contacts": 0,
}


@pytest.fixture
def script(monkeypatch: pytest.MonkeyPatch) -> Any:
    monkeypatch.syspath_prepend(str(SCRIPT.parent))
    spec = importlib.util.spec_from_file_location("live_worlds", SCRIPT)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_a_series_goes_on_where_it_was_and_names_what_failed(
    script: Any,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    explored: list[DemoConfig] = []

    def run_demo(config: DemoConfig, out: Path, console: Console) -> dict[str, object]:
        explored.append(config)
        if config.world == "cave" and len(explored) < 4:
            raise ProcessError("simulator ended with status 1")
        return {"world": config.world, "seed": config.seed, **FIGURES}

    monkeypatch.setattr(script, "run_demo", run_demo)
    command = ["live_worlds", "--worlds", "mars:1", "cave:3", "office:2", "--out", str(tmp_path)]
    monkeypatch.setattr("sys.argv", [*command, "--known-fraction", "0.9"])
    assert script.main() == 1
    assert "cave 3: simulator ended with status 1" in capsys.readouterr().err
    assert script.main() == 0

    names = [(config.world, config.seed) for config in explored]
    assert names == [("mars", 1), ("cave", 3), ("office", 2), ("cave", 3)]
    assert {(config.size, config.known_fraction) for config in explored} == {(0.0, 0.9)}
    rows = (tmp_path / "table.md").read_text().splitlines()
    kept = json.loads((tmp_path / "mars_1.json").read_text())
    assert rows[2] == (
        "| rover | mars 1 | done: enough / known | 12 | 7.2 m | 301 s | 96.1 % | 95.2 % "
        f"| 68 / 95 / - % | 1.04 | 0 | {kept['software']} |"
    )
    assert [row.split("|")[2].strip() for row in rows[2:]] == ["mars 1", "cave 3", "office 2"]
    assert version("infomap-ros") in kept["software"]
