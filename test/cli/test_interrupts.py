"""Ctrl-C ends a command in order, and keeps what it has done."""

from __future__ import annotations

import io
import json
import signal
import sys

import pytest
from rich.console import Console

from infomap_ros import cli
from infomap_ros.cli.results import INTERRUPTED, stops_when_interrupted
from infomap_ros.mapping import VoxelMap
from infomap_ros.replay.map_run import MapRun

from ..replay.scenes import depth_frames, write

_DONE = 3  # frames after which the user interrupts


def test_an_interrupt_asks_the_work_to_stop_and_a_second_one_leaves():
    asked, said = [], io.StringIO()
    before = signal.getsignal(signal.SIGINT)
    with stops_when_interrupted(lambda: asked.append(1), Console(file=said), "map and report"):
        signal.raise_signal(signal.SIGINT)
        assert asked == [1]
        assert "map and report follow" in said.getvalue()
        with pytest.raises(KeyboardInterrupt):
            signal.raise_signal(signal.SIGINT)
    assert signal.getsignal(signal.SIGINT) is before


def test_an_interrupted_map_is_written(tmp_path, monkeypatch, capsys):
    note = MapRun._note

    def interrupting(run, done):
        note(run, done)
        if run.frames == _DONE:
            signal.raise_signal(signal.SIGINT)

    monkeypatch.setattr(MapRun, "_note", interrupting)
    bag, out = write(tmp_path / "bag", depth_frames()), tmp_path / "out"
    monkeypatch.setattr(sys, "argv", ["infomap", "map", str(bag), "--out", str(out)])
    with pytest.raises(SystemExit) as ended:
        cli.main()
    assert ended.value.code == INTERRUPTED
    captured = capsys.readouterr()
    summary = json.loads(captured.out)
    assert summary["frames"] == _DONE, "poses come before their images"
    assert summary["interrupted"] == 1
    assert "the results so far follow" in captured.err
    assert VoxelMap.load(out / "map.infomap").known_voxels == summary["known_voxels"] > 0
    assert (out / "map.html").is_file() and (out / "map.png").is_file()
