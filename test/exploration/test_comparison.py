"""Several runs on one page, without a browser."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest

from infomap_ros.errors import InvalidInputError
from infomap_ros.exploration.reports.comparison import LOG_FILE, write_comparison
from infomap_ros.exploration.reports.report_page.charts import DASH

from .made_up_run import entries, made_up_map


def leave_run(folder: Path, strategy: str, views: int, **figures: object) -> Path:
    """What a run leaves in its folder, but for the map."""
    folder.mkdir(parents=True)
    found = entries(views)
    found[0]["strategy"] = strategy
    text = "\n".join(json.dumps(entry) for entry in found) + "\n"
    (folder / "exploration.jsonl").write_text(text, encoding="utf-8")
    (folder / "summary.json").write_text(json.dumps(figures), encoding="utf-8")
    return folder


def rows_of(page: str, section: str) -> dict[str, list[str]]:
    """The rows of a section's table, by their first cell."""
    body = page.split(f'<section id="{section}">')[1].split("</section>")[0]
    rows = re.findall(r"<tr[^>]*>(.*?)</tr>", body)
    cells = [re.findall(r"<t[dh][^>]*>(.*?)</t[dh]>", row) for row in rows]
    return {row[0]: row[1:] for row in cells}


def test_the_page_sets_runs_side_by_side(tmp_path: Path) -> None:
    first = leave_run(tmp_path / "a", "random", 6, true_coverage=0.71, end="done")
    second = leave_run(
        tmp_path / "b", "look_ahead", 12, true_coverage=0.93, contacts=0,
        pose_turn_rms=0.0037, within_1_sigma=0.683,
    )  # fmt: skip
    made_up_map().save(first / "map.infomap")
    out = tmp_path / "comparison.html"

    write_comparison(out, {"a <1>": first, "b": second})

    page = out.read_text("utf-8")
    asked = rows_of(page, "asked")
    assert asked[""] == ["a &lt;1&gt;", "b"]
    assert asked["strategy"] == ["random", "look_ahead"]
    assert "robot" not in asked  # the same in both
    assert rows_of(page, "results")["views"] == ["6", "12"]
    figures = rows_of(page, "figures")
    assert figures["true coverage"] == ["71\u2009%", "93\u2009%"]
    assert figures["pose turn rms"] == [DASH, "3.7\u2009mrad"]
    assert figures["within 1 sigma"] == [DASH, "68.3\u2009%"]
    assert figures["contacts"] == [DASH, "0"]
    assert "end" not in figures  # no number
    charts = re.findall(r'<svg class="chart".*?</svg>', page)
    assert len(charts) == 12  # four values over views, meters and time
    assert all(chart.count('class="curve run-') == 2 for chart in charts)
    assert page.count('<svg class="plan"') == 1
    assert "no map file" in page
    assert not re.search(r"""(src|href)=["'](?!data:|#)""", page)


def test_a_chart_tells_whose_curve_the_pointer_is_at(tmp_path: Path) -> None:
    runs = {name: leave_run(tmp_path / name, "random", 6) for name in ("slow", "fast")}
    write_comparison(tmp_path / "c.html", runs)

    chart = re.findall(r'<svg class="chart".*?</svg>', (tmp_path / "c.html").read_text("utf-8"))[0]
    assert {"slow", "fast"} == set(re.findall(r"&quot;(slow|fast): ", chart))


def test_curves_are_functions_and_there_are_none_over_what_stayed_zero(tmp_path: Path) -> None:
    runs = {name: leave_run(tmp_path / name, "random", 6) for name in ("a", "b")}
    for folder in runs.values():  # a camera on a post: more than one entry at a view, no distance
        lines = [json.loads(line) for line in (folder / LOG_FILE).read_text("utf-8").splitlines()]
        told = [line | {"distance": 0.0} for line in lines if line["kind"] == "progress"]
        later = [line | {"t": line["t"] + 0.5, "known_fraction": 0.5} for line in told[-1:]]
        text = "\n".join(map(json.dumps, [lines[0], *told, *later])) + "\n"
        (folder / LOG_FILE).write_text(text, encoding="utf-8")
    write_comparison(tmp_path / "c.html", runs)

    page = (tmp_path / "c.html").read_text("utf-8")
    charts = re.findall(r'<svg class="chart".*?</svg>', page)
    assert len(charts) == 8  # over views and time
    assert "no curves over distance driven [m]" in page
    for chart in charts:
        for points in re.findall(r'<polyline class="curve[^>]*points="([^"]*)"', chart):
            places = [float(point.split(",")[0]) for point in points.split()]
            assert len(set(places)) == len(places) > 3


def test_what_is_no_run_is_named(tmp_path: Path) -> None:
    run = leave_run(tmp_path / "a", "random", 6)
    (tmp_path / "empty").mkdir()
    with pytest.raises(InvalidInputError, match=r"empty.*holds no exploration\.jsonl"):
        write_comparison(tmp_path / "c.html", {"a": run, "empty": tmp_path / "empty"})
    (run / "summary.json").write_text("[1", encoding="utf-8")
    with pytest.raises(InvalidInputError, match=r"summary\.json.*not JSON"):
        write_comparison(tmp_path / "c.html", {"a": run, "b": run})
    with pytest.raises(InvalidInputError, match="at least two"):
        write_comparison(tmp_path / "c.html", {"a": run})
    assert not (tmp_path / "c.html").exists()
