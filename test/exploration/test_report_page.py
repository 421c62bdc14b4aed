"""The parts of the report that need no browser to be checked."""

from __future__ import annotations

import base64
import json
import re
import zlib
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from infomap_ros.errors import MapFileError, RunLogError
from infomap_ros.exploration.records.choice_text import grown_voxels
from infomap_ros.exploration.records.recorded_run import read_run
from infomap_ros.exploration.reports.report import write_map_report, write_report
from infomap_ros.exploration.reports.report_page import scene
from infomap_ros.exploration.reports.report_page.charts import (
    DASH,
    MINUS,
    Curve,
    duration,
    line_chart,
    number,
    quantity,
    round_ticks,
)
from infomap_ros.exploration.reports.report_page.scene import (
    LOG_ODDS_RANGE,
    SIGMA_RANGE,
    drawn_surface,
    pack,
)
from infomap_ros.exploration.reports.report_page.sections import kind_of
from infomap_ros.mapping import VoxelMap
from infomap_ros.mapping.files.export import surface_sigmas

from .made_up_run import entries, growing_map, made_up_map, write_log


@pytest.fixture(scope="module")
def voxel_map() -> VoxelMap:
    return made_up_map()


@pytest.fixture(scope="module")
def report(voxel_map: VoxelMap, tmp_path_factory: pytest.TempPathFactory) -> str:
    folder = tmp_path_factory.mktemp("report")
    write_report(folder / "report.html", write_log(folder / "run.jsonl"), voxel_map, "Stones")
    return (folder / "report.html").read_text("utf-8")


class Reader(HTMLParser):
    """Collects the tables, the embedded data, and every attribute that could load something."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.links: list[str] = []
        self.rows: dict[str, list[list[str]]] = {}
        self.data: dict[str, str] = {}
        self._table = self._id = ""
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        values = dict(attrs)
        self.links += [values[key] or "" for key in ("src", "href") if key in values]
        self._id = values.get("id") or "" if tag == "script" else ""
        if tag == "table":
            self._table = values.get("class") or ""
            self.rows[self._table] = []
        elif tag == "tr":
            self.rows[self._table].append([])
        elif tag == "td":
            self.rows[self._table][-1].append("")

    def handle_endtag(self, tag: str) -> None:
        if tag == "table":
            self._table = ""

    def handle_data(self, data: str) -> None:
        if self._id:
            self.data[self._id] = self.data.get(self._id, "") + data
        elif self._table and self.rows[self._table] and self.rows[self._table][-1]:
            self.rows[self._table][-1][-1] += data


def unpacked(reader: Reader) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """Manifest and arrays of a page."""
    manifest = json.loads(reader.data["manifest"])
    block = zlib.decompress(base64.b64decode(reader.data["arrays"]))
    arrays = {
        name: np.frombuffer(block, place["type"], place["count"], place["offset"])
        for name, place in manifest["arrays"].items()
    }
    return manifest, arrays


def test_page_loads_nothing(report: str) -> None:
    links = Reader(report).links
    assert links
    assert all(link.startswith("data:") for link in links)
    assert "default-src 'none'" in report
    addresses = set(re.findall(r"https?://[^\s\"'<)]+", report))
    assert addresses <= {"http://www.w3.org/2000/svg"}  # a name, not a place


def test_viewer_gets_the_voxels_of_the_map(report: str, voxel_map: VoxelMap) -> None:
    manifest, arrays = unpacked(Reader(report))
    indices, _, covariances = voxel_map.gaussians()
    cells = arrays["cells"].reshape(-1, 3) + np.array(manifest["first"])
    np.testing.assert_array_equal(cells, indices)
    assert manifest["voxel"] == voxel_map.config.voxel_size
    low, high = np.log(SIGMA_RANGE)
    sigmas = np.exp(low + arrays["sigmas"] / 255.0 * (high - low))
    np.testing.assert_allclose(sigmas, surface_sigmas(covariances), rtol=0.02)
    odds = voxel_map.log_odds((indices + 0.5) * voxel_map.config.voxel_size)
    clipped = np.clip(odds, *LOG_ODDS_RANGE)
    np.testing.assert_allclose(arrays["evidence"] / 255.0 * LOG_ODDS_RANGE[1], clipped, atol=0.02)


def test_normals_are_those_along_which_the_surface_is_thinnest(voxel_map: VoxelMap) -> None:
    surface = drawn_surface(voxel_map)
    _, _, covariances = voxel_map.gaussians()
    normals = surface.normals / 127.0
    along = np.einsum("ni,nij,nj->n", normals, covariances, normals)
    thinnest = np.linalg.eigvalsh(covariances)[:, 0]
    np.testing.assert_allclose(np.sqrt(along), np.sqrt(thinnest), rtol=0.05, atol=3e-4)
    assert (normals[:, 2] >= 0.0).all()


def test_a_large_map_is_merged_without_a_hole(voxel_map: VoxelMap) -> None:
    surface = drawn_surface(voxel_map, most=2000)
    assert 0 < len(surface.cells) <= 2000
    indices, _, _ = voxel_map.gaussians()
    merged = np.unique(indices // surface.merged, axis=0)
    found = np.unique(surface.cells + surface.first, axis=0)
    np.testing.assert_array_equal(found, merged)
    assert surface.size == surface.merged * voxel_map.config.voxel_size


def test_viewer_gets_every_candidate(report: str) -> None:
    manifest, arrays = unpacked(Reader(report))
    decisions = [entry for entry in entries() if entry["kind"] == "decision"]
    candidates = [candidate for entry in decisions for candidate in entry["candidates"]]
    starts = np.cumsum([0] + [len(entry["candidates"]) for entry in decisions])
    np.testing.assert_array_equal(arrays["candidate_starts"], starts)
    places = arrays["candidate_positions"].reshape(-1, 3)
    np.testing.assert_allclose(places, [c["position"] for c in candidates], atol=1e-6)
    reasons = [manifest["rejections"][i] for i in arrays["candidate_rejections"]]
    assert reasons == [c["rejection"] for c in candidates]
    terms = arrays["candidate_terms"].reshape(len(candidates), -1)
    for column, name in enumerate(manifest["terms"]):
        np.testing.assert_allclose(terms[:, column], [c["terms"][name] for c in candidates], 1e-6)


def test_of_very_many_candidates_each_decision_shows_some(
    tmp_path: Path, voxel_map: VoxelMap, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(scene, "LARGEST_CHOICE", 300)
    write_report(tmp_path / "r.html", write_log(tmp_path / "run.jsonl"), voxel_map)
    manifest, arrays = unpacked(Reader((tmp_path / "r.html").read_text("utf-8")))
    shown = np.diff(arrays["candidate_starts"])
    assert (shown == 20).all()  # every third of 60
    assert [step["considered"] for step in manifest["steps"]] == [60] * 13


def test_hundred_thousand_voxels_fit_into_ten_megabytes() -> None:
    rng = np.random.default_rng(0)
    count = 100_000
    arrays = {  # of random content, which does not compress
        "cells": rng.integers(0, 65536, (count, 3)).astype(np.uint16),
        "normals": rng.integers(-127, 128, (count, 3)).astype(np.int8),
        "sigmas": rng.integers(0, 256, count).astype(np.uint8),
        "evidence": rng.integers(0, 256, count).astype(np.uint8),
    }
    assert len(pack(arrays)[1]) < 10_000_000


def test_table_tells_every_view(report: str) -> None:
    rows = Reader(report).rows["views"][1:]
    decisions = [entry for entry in entries() if entry["kind"] == "decision"]
    told, reasons = rows[0::2], rows[1::2]
    assert [row[0] for row in told] == [str(entry["view"]) for entry in decisions]
    assert reasons == [[entry["reason"]] for entry in decisions]
    assert told[5][-1] == "drive: blocked after 0.4 m"


def test_rejections_are_counted_by_reason(report: str) -> None:
    rows = Reader(report).rows["rejections"][1:]
    counts: dict[str, int] = {}
    for entry in entries():
        for candidate in entry.get("candidates", ()):
            if candidate["rejection"]:
                kind = candidate["rejection"].split(":")[0]
                counts[kind] = counts.get(kind, 0) + 1
    assert {row[0]: int(row[1].replace(",", "")) for row in rows} == counts


def test_reasons_that_differ_in_a_number_are_one_row() -> None:
    stances = [f"the arm is free at none of {count} stances: mostly arm" for count in (50, 13, 5)]
    assert {kind_of(reason) for reason in stances} == {"the arm is free at none of N stances"}
    assert kind_of("in collision: wheel") == "in collision"


def test_text_of_the_log_cannot_become_markup(tmp_path: Path, voxel_map: VoxelMap) -> None:
    told = entries(count=2, candidates=2)
    hostile = "</script><script>document.title='broken'</script><img src=x onerror=alert(1)>"
    told[0]["robot"] = told[0]["world"] = hostile
    told[2]["reason"] = told[2]["candidates"][0]["rejection"] = hostile
    told[2]["terms"] = {hostile: 1.0}
    told[-1]["detail"] = hostile
    path = tmp_path / "run.jsonl"
    path.write_text("".join(json.dumps(entry) + "\n" for entry in told), encoding="utf-8")
    write_report(tmp_path / "report.html", path, voxel_map, hostile)
    text = (tmp_path / "report.html").read_text("utf-8")
    assert "<img src=x" not in text
    assert text.count("<script") == 3
    manifest, _ = unpacked(Reader(text))
    assert hostile in manifest["rejections"]


def test_a_cut_log_makes_a_report_that_says_so(tmp_path: Path, voxel_map: VoxelMap) -> None:
    path = write_log(tmp_path / "run.jsonl")
    path.write_bytes(path.read_bytes()[:-30])
    run = write_report(tmp_path / "report.html", path, voxel_map)
    lines = len(entries())
    assert run.problems == (f"line {lines}: is cut off",)
    text = (tmp_path / "report.html").read_text("utf-8")
    assert f"line {lines}: is cut off" in text
    assert "Not ended" in text


def test_a_foreign_log_leaves_no_report(tmp_path: Path, voxel_map: VoxelMap) -> None:
    path = tmp_path / "notes.txt"
    path.write_text("nothing of the kind\n", encoding="utf-8")
    with pytest.raises(RunLogError, match="line 1: is not JSON"):
        write_report(tmp_path / "report.html", path, voxel_map)
    assert not (tmp_path / "report.html").exists()


def test_a_map_file_that_is_none_is_refused(tmp_path: Path) -> None:
    path = write_log(tmp_path / "run.jsonl")
    with pytest.raises(MapFileError):
        write_report(tmp_path / "report.html", path, path)


def test_an_empty_map_has_a_report(tmp_path: Path) -> None:
    write_report(tmp_path / "report.html", write_log(tmp_path / "run.jsonl"), VoxelMap())
    assert "The map has no surface." in (tmp_path / "report.html").read_text("utf-8")


def test_a_map_without_a_run_has_its_own_report(tmp_path: Path, voxel_map: VoxelMap) -> None:
    voxel_map.save(tmp_path / "map")
    figures = {"frames": 12, "voxel_size": 0.05}
    write_map_report(tmp_path / "r.html", tmp_path / "map", "Map", "From a bag.", figures)
    reader = Reader((tmp_path / "r.html").read_text("utf-8"))
    assert reader.rows["parameters"][1:] == [["frames", "12"], ["voxel size", "50\u2009mm"]]
    assert "views" not in reader.rows


def test_chart_places_its_points_in_proportion() -> None:
    chart = line_chart(
        Curve("known", "%", [0, 1, 2, 4], [0.0, 50.0, 100.0, np.nan], "views", high=100.0)
    )
    match = re.search(r'polyline class="curve" points="([^"]+)"', chart)
    assert match is not None
    places = np.array([[float(v) for v in pair.split(",")] for pair in match[1].split()])
    assert len(places) == 3
    steps = np.diff(places, axis=0)
    np.testing.assert_allclose(steps[0], steps[1], atol=0.11)
    assert steps[0, 0] > 0.0 > steps[0, 1]


def test_chart_without_values_says_so() -> None:
    assert "no value in the log" in line_chart(Curve("sigma", "m", [0.0], [np.nan], "views"))


@pytest.mark.parametrize(
    ("low", "high", "ticks"),
    [
        (0.0, 10.0, [0, 2, 4, 6, 8, 10]),
        (-0.31, 0.32, [-0.2, 0.0, 0.2]),
        (0.0, 1.0, [0.0, 0.2, 0.4, 0.6, 0.8, 1.0]),
        (3.0, 3.0, [3.0]),
    ],
)
def test_ticks_are_round(low: float, high: float, ticks: list[float]) -> None:
    np.testing.assert_allclose(round_ticks(low, high), ticks)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        (quantity(0.0061, "m"), "6.1 mm"),
        (quantity(48_000.0, "bit"), "48 kbit"),
        (quantity(999.9, "m"), "1 km"),
        (quantity(float("nan"), "m"), DASH),
        (quantity(0.0, "m"), "0 m"),
        (number(-12.345), f"{MINUS}12.3"),
        (number(1234.0), "1 234"),
        (duration(42.0), "42 s"),
        (duration(185.0), "3 min 05 s"),
        (duration(4320.0), "1 h 12 min"),
    ],
)
def test_numbers_are_readable(text: str, expected: str) -> None:
    assert text.replace("\u2009", " ") == expected


def test_each_voxel_is_shown_from_the_decision_on_that_knew_it_first(tmp_path: Path) -> None:
    run = read_run(write_log(tmp_path / "run.jsonl", 4, voxel_size=0.1))
    surface = drawn_surface(made_up_map(4, 0.1))
    seen = scene.scene_of(surface, None, run)["arrays"]["seen"]
    cells = list(map(tuple, surface.cells + surface.first))
    known: set[tuple[int, ...]] = set()
    for decision, voxel_map in enumerate(growing_map(4, 0.1)):
        known |= set(map(tuple, voxel_map.gaussians()[0]))
        shown = {cell for cell, first in zip(cells, seen, strict=True) if first <= decision}
        assert shown == known & set(cells)
    assert len(set(seen)) > 3


@pytest.mark.parametrize("text", ["no base64", "AAAA", "eJw="])
def test_a_surface_that_cannot_be_read_is_named(text: str) -> None:
    with pytest.raises(RunLogError, match="'surface' of a decision"):
        grown_voxels(text)
