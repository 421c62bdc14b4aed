"""What was predicted of the pose at the chosen views is compared with what it was on arrival."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from infomap_ros.exploration.records.recorded_run import RecordedRun, read_run
from infomap_ros.exploration.records.run_figures import (
    PosePrediction,
    pose_predictions,
    prediction_figures,
)
from infomap_ros.exploration.records.run_log import RunLogFile


def run_of(path: Path, choices: list[tuple[float | None, float, str | None]]) -> RecordedRun:
    """A run of choices: position sigma then, predicted growth, outcome of the look (None: none)."""
    log = RunLogFile(path)
    log.write("start", task={}, robot="rover", world="", strategy="random")
    for view, (sigma, growth, outcome) in enumerate(choices):
        told = {} if sigma is None else {"position_sigma": sigma}
        terms = {"localization_error": growth}
        log.write("decision", view=view, pose=np.eye(4).ravel(), terms=terms, candidates=[], **told)
        if outcome is not None:
            log.write("motion", action="look", outcome=outcome, path=[])
    return read_run(path)


def test_each_arrival_is_compared_with_its_prediction(tmp_path: Path) -> None:
    run = run_of(
        tmp_path / "run.jsonl",
        [(0.010, 0.004, ""), (0.021, -0.007, ""), (0.007, 0.001, None), (0.008, 0.0, "")],
    )
    assert pose_predictions(run) == [
        PosePrediction(0.010, pytest.approx(0.014), 0.021),
        PosePrediction(0.021, pytest.approx(0.014), 0.007),
    ]
    figures = prediction_figures(run)
    assert figures["predicted_sigmas"] == 2
    assert figures["arrived_over_predicted_median"] == pytest.approx((1.5 + 0.5) / 2)


def test_views_that_failed_and_logs_that_do_not_tell_count_nothing(tmp_path: Path) -> None:
    failed = run_of(tmp_path / "a.jsonl", [(0.01, 0.004, "no pose"), (0.02, 0.0, "")])
    untold = run_of(tmp_path / "b.jsonl", [(None, 0.004, ""), (0.02, 0.0, "")])
    assert pose_predictions(failed) == pose_predictions(untold) == []
    assert prediction_figures(failed) == {}
