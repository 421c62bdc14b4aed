"""Real corners of tags, found by another detector: poses are those of TagSLAM's optimum."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

BENCHMARKS = Path(__file__).resolve().parents[2] / "benchmarks"


@pytest.fixture
def figures(monkeypatch: pytest.MonkeyPatch) -> Any:
    monkeypatch.syspath_prepend(str(BENCHMARKS))
    import given_landmarks

    return given_landmarks.tag_corners


def test_tags_of_which_one_is_given_tell_the_pose(real_data: Path, figures: Any) -> None:
    folder = real_data / "tag_corners" / "test_17"
    if not folder.is_dir():
        pytest.skip(f"real data absent: no folder {folder}")
    row = figures(folder, ["cam0"], most=40)
    assert row["images"] == row["updated"] == 40
    assert row["median_mm"] < 10.0
    assert row["median_deg"] < 0.5
    assert row["nees_median"] < 1.5
