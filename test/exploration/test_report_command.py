"""Command ``infomap report``."""

from __future__ import annotations

from pathlib import Path

import pytest
from typer.testing import CliRunner

from infomap_ros.cli.app import app
from infomap_ros.errors import InvalidInputError

from .made_up_run import made_up_map, write_log


def call(*arguments: object) -> str:
    """What the command prints."""
    result = CliRunner().invoke(app, ["report", *map(str, arguments)], catch_exceptions=False)
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        raise result.exception
    return result.output.strip()


@pytest.fixture
def run(tmp_path: Path) -> Path:
    """What the explorer and map_fusion of a robot leave: no summary."""
    folder = tmp_path / "monday" / "run"
    folder.mkdir(parents=True)
    write_log(folder / "exploration.jsonl")
    made_up_map().save(folder / "map.infomap")
    return folder


def test_one_run_gets_its_report(run: Path) -> None:
    assert call(run) == str(run / "report.html")
    page = (run / "report.html").read_text("utf-8")
    assert "The map in 3-D" in page


def test_runs_of_one_name_are_told_apart(run: Path, tmp_path: Path) -> None:
    other = tmp_path / "tuesday" / "run"
    other.parent.mkdir()
    run.rename(other)
    run.mkdir()
    write_log(run / "exploration.jsonl", 4)

    assert call(run, other, "--out", tmp_path / "both.html") == str(tmp_path / "both.html")

    page = (tmp_path / "both.html").read_text("utf-8")
    assert "monday/run" in page
    assert "tuesday/run" in page


def test_a_run_without_a_map_is_refused(run: Path) -> None:
    (run / "map.infomap").unlink()
    with pytest.raises(InvalidInputError, match=r"holds no map\.infomap"):
        call(run)
    with pytest.raises(InvalidInputError, match="given twice"):
        call(run, run)
