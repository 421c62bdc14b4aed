"""A run as a recording for rerun."""

from __future__ import annotations

import importlib.util
import sys
from collections import Counter
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from infomap_ros.errors import MissingExtraError
from infomap_ros.exploration.reports.rerun_recording import TIMELINE, write_recording
from infomap_ros.mapping import VoxelMap

from .made_up_run import entries, made_up_map, write_log

HAS_RERUN = importlib.util.find_spec("rerun") is not None


@pytest.fixture(scope="module")
def voxel_map() -> VoxelMap:
    return made_up_map(count=4, voxel_size=0.1)


class Notes:
    """Stands in for rerun: notes what is logged, where and when."""

    def __init__(self) -> None:
        self.time: float | None = None
        self.logged: list[tuple[str, float | None, Any]] = []
        self.module = SimpleNamespace(
            RecordingStream=lambda _name: self,
            ViewCoordinates=SimpleNamespace(RIGHT_HAND_Z_UP="up"),
            **{
                name: lambda *values, **options: (*values, options)
                for name in ("Points3D", "LineStrips3D", "Scalars", "TextLog", "Pinhole")
            },
            Transform3D=lambda **options: options,
        )

    def save(self, path: str) -> None:
        Path(path).touch()

    def set_time(self, timeline: str, duration: float) -> None:
        assert timeline == TIMELINE
        self.time = duration

    def log(self, path: str, entity: Any, static: bool = False) -> None:
        self.logged.append((path, None if static else self.time, entity))

    def disconnect(self) -> None:
        pass


def test_everything_of_the_run_is_recorded_at_its_time(
    tmp_path: Path, voxel_map: VoxelMap, monkeypatch: pytest.MonkeyPatch
) -> None:
    notes = Notes()
    monkeypatch.setitem(sys.modules, "rerun", notes.module)
    write_recording(tmp_path / "run.rrd", write_log(tmp_path / "run.jsonl"), voxel_map)
    told = entries()
    times = {
        path: [time for name, time, _ in notes.logged if name == path]
        for path in {name for name, _, _ in notes.logged}
    }
    progress = [entry["t"] for entry in told if entry["kind"] == "progress"]
    assert times["progress/known_fraction"] == progress
    assert times["progress/mean_sigma"] == progress[1:]  # before the first view there is none
    decisions = [entry for entry in told if entry["kind"] == "decision"]
    assert times["decisions"] == times["map/candidates/rejected"] == [e["t"] for e in decisions]
    for entry in decisions[:-1]:
        assert set(times[f"map/views/{entry['view']}"]) == {entry["t"]}
    ways = [e for e in told if e["kind"] == "motion" and e["path"]]
    paths = [name for name in times if name.startswith("map/paths/")]
    assert len(paths) == len(ways)
    assert times["map/surface"] == [None]
    (surface,) = (entity for name, _, entity in notes.logged if name == "map/surface")
    np.testing.assert_allclose(surface[0], voxel_map.gaussians()[1], atol=1e-6)


def test_without_rerun_the_error_says_what_to_install(
    tmp_path: Path, voxel_map: VoxelMap, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "rerun", None)
    with pytest.raises(MissingExtraError, match=r"pip install 'infomap_ros\[rerun\]'"):
        write_recording(tmp_path / "run.rrd", write_log(tmp_path / "run.jsonl"), voxel_map)


@pytest.mark.skipif(not HAS_RERUN, reason="the extra rerun is not installed")
def test_rerun_reads_the_recording(tmp_path: Path, voxel_map: VoxelMap) -> None:
    from rerun.chunk import RrdReader

    write_recording(tmp_path / "run.rrd", write_log(tmp_path / "run.jsonl"), voxel_map)
    rows: Counter[str] = Counter()
    known: dict[float, float] = {}
    for chunk in RrdReader(tmp_path / "run.rrd").stream().to_chunks():
        path = str(chunk.entity_path)
        rows[path] += chunk.num_rows
        if path == "/progress/known_fraction":
            table = chunk.to_record_batch().to_pydict()
            times = [time.total_seconds() for time in table[TIMELINE]]
            values = [row[0] for row in table["Scalars:scalars"]]
            known.update(zip(times, values, strict=True))
    progress = [entry for entry in entries() if entry["kind"] == "progress"]
    assert sorted(known) == pytest.approx([entry["t"] for entry in progress], abs=1e-6)
    assert [known[t] for t in sorted(known)] == [entry["known_fraction"] for entry in progress]
    assert rows["/map/surface"] == 1
    assert rows["/decisions"] == sum(entry["kind"] == "decision" for entry in entries())
