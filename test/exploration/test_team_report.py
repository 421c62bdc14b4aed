"""The report of a team, without a browser."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest

from infomap_ros.errors import InvalidInputError
from infomap_ros.exploration.reports.comparison import write_team_report

from .made_up_run import made_up_map, write_log


def test_the_report_shows_all_robots(tmp_path: Path) -> None:
    logs = {name: write_log(tmp_path / f"{name}.jsonl") for name in ("rover <1>", "rover 2")}
    out = tmp_path / "report.html"

    write_team_report(out, logs, made_up_map(), "Two & more", {"map hash": "c0ffee"})

    page = out.read_text("utf-8")
    assert "rover &lt;1&gt;</h3>" in page
    assert "rover 2</h3>" in page
    assert "<title>Two &amp; more</title>" in page
    assert "c0ffee" in page
    assert page.count('class="chart"') == 3  # views, meters and time
    assert page.count('class="curve run-1"') == 3
    paths = [page.count(f'<polyline class="{kind}"') for kind in ("base", "base dashed")]
    assert paths[0] == paths[1] > 0
    steps = re.findall(r'data-step="(\d+)"', page)
    assert len(set(steps)) == len(steps) > 2  # each view is one of the 3-D scene
    manifest = re.search(r'<script id="manifest" type="application/json">(.*?)</script>', page)
    assert manifest is not None
    assert len(json.loads(manifest[1])["steps"]) > max(map(int, steps))
    assert not re.search(r"""(src|href)=["'](?!data:|#)""", page)


def test_there_must_be_a_robot(tmp_path: Path) -> None:
    with pytest.raises(InvalidInputError, match="no run logs"):
        write_team_report(tmp_path / "report.html", {}, made_up_map(), "Nobody")
