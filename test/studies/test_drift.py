"""The drift study: its walks against the truth, and its figures against naive statistics."""

from __future__ import annotations

import json
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from infomap_ros.cli import app
from infomap_ros.geometry import invert_transform, transform_points
from infomap_ros.studies.drift import (
    METHODS,
    DriftConfig,
    DriftPanel,
    WalkErrors,
    draw_drift,
    drift_rows,
    panels_of,
    tasks_of,
)
from infomap_ros.studies.fiducial_walk import CAMERA, WalkConfig, walk
from infomap_ros.studies.runs import Kept

SMALL = DriftConfig(runs=6, distances=(1.1,), redundancies=(2,), seed=3, walk=WalkConfig(steps=15))


@pytest.fixture(scope="module")
def panel() -> DriftPanel:
    (only,) = panels_of({task: task.run() for task in tasks_of(SMALL)})
    return only


def test_steps_have_the_length_that_they_should(rng: np.random.Generator) -> None:
    frames = list(walk(WalkConfig(steps=8, step=0.03), 6, 1.0, rng))
    positions = np.array([frame.T_map_camera[:3, 3] for frame in frames])
    np.testing.assert_allclose(np.linalg.norm(np.diff(positions, axis=0), axis=1), 0.03)
    np.testing.assert_array_equal(frames[0].T_map_camera, np.eye(4))


def test_followed_fiducials_are_measured_at_both_ends(rng: np.random.Generator) -> None:
    frames = list(walk(WalkConfig(steps=20), 6, 0.35, rng))
    for before, after in pairwise(frames):
        assert len(before.followed) == 6
        assert np.isin(before.followed, before.observations.ids).all()
        assert np.isin(before.followed, after.observations.ids).all()


def test_measurements_err_as_much_as_they_say(rng: np.random.Generator) -> None:
    """One fiducial at a time, put back where the first image saw it without noise."""
    quiet = WalkConfig(steps=30, pixel_sigma=0.01, disparity_sigma=0.01)
    noisy = WalkConfig(steps=30)
    seed = int(rng.integers(1 << 30))
    normalized = []
    for exact, measured in zip(
        walk(quiet, 16, 1.1, np.random.default_rng(seed)),
        walk(noisy, 16, 1.1, np.random.default_rng(seed)),
        strict=True,
    ):
        np.testing.assert_array_equal(exact.observations.ids, measured.observations.ids)
        off = measured.observations.pixels - exact.observations.pixels
        normalized.append(off / 0.29)  # both have the same noise, scaled
        rho = measured.observations.inverse_depths - exact.observations.inverse_depths
        normalized.append(rho[:, None] / (0.29 / (CAMERA.fx * 0.12)))
    assert np.concatenate([part.ravel() for part in normalized]).std() == pytest.approx(
        1.0, abs=0.05
    )


def test_distances_are_as_asked(rng: np.random.Generator) -> None:
    frame = next(walk(WalkConfig(), 200, 1.1, rng))
    points = frame.observations.points(CAMERA)
    inside = transform_points(invert_transform(frame.T_map_camera), points)
    assert inside[:, 2].mean() == pytest.approx(1.1, abs=0.05)


def test_the_default_drifts_less_than_the_printed_method(panel: DriftPanel) -> None:
    assert panel.ratio < 0.5
    assert panel.rms("weighted")[-1] < panel.rms("printed")[-1]


def test_every_method_starts_at_the_truth(panel: DriftPanel) -> None:
    for method in METHODS:
        np.testing.assert_allclose(panel.errors[method][:, 0], 0.0, atol=1e-12)
        assert panel.errors[method].shape == (6, 16)


def test_bands_hold_the_rms_and_narrow_with_more_runs() -> None:
    rng = np.random.default_rng(1)
    few, many = (
        DriftPanel(1.0, 1, {"printed": np.abs(rng.normal(0, 2, (runs, 4)))}) for runs in (20, 2000)
    )
    for panel in (few, many):
        low, high = panel.band("printed")
        assert np.all((low < panel.rms("printed")) & (panel.rms("printed") < high))
    width_few, width_many = (np.ptp(panel.band("printed"), axis=0).mean() for panel in (few, many))
    # The standard error of an RMS of n normal values is sigma / sqrt(2 n).
    assert width_many == pytest.approx(2 * 1.96 * 2 / np.sqrt(2 * 2000), rel=0.2)
    assert width_few > 5 * width_many


def test_the_csv_holds_the_curves(panel: DriftPanel) -> None:
    rows = drift_rows([panel])
    assert len(rows) == 1 + 3 * 16
    last = dict(zip(rows[0].split(","), rows[-1].split(","), strict=True))
    assert last["method"] == "default" and last["step"] == "15"
    assert float(last["rms_m"]) == pytest.approx(panel.rms("default")[-1], rel=1e-4)


def test_the_figure_is_written(panel: DriftPanel, tmp_path: Path) -> None:
    paths = [tmp_path / "drift.png", tmp_path / "drift.svg"]
    draw_drift([panel], paths)
    assert paths[0].read_bytes().startswith(b"\x89PNG")
    assert "<svg" in paths[1].read_text("utf-8")


def test_walks_of_all_panels_are_paired_by_their_number() -> None:
    config = DriftConfig(runs=4, redundancies=(1, 2))
    tasks = tasks_of(config)
    assert len({task.file_name for task in tasks}) == len(tasks) == 4 * 2 * 2
    errors = {
        task: WalkErrors(*(np.full(3, float(task.number)) for _ in METHODS)) for task in tasks
    }
    panels = panels_of(errors)
    assert [(panel.distance, panel.redundancy) for panel in panels] == [
        (1.1, 1), (1.1, 2), (0.35, 1), (0.35, 2),
    ]  # fmt: skip
    for panel in panels:
        np.testing.assert_array_equal(panel.errors["weighted"][:, 0], [0.0, 1.0, 2.0, 3.0])


@pytest.mark.parametrize(("error", "status"), [(0.4, 0), (0.6, 1)])
def test_the_command_leaves_its_results(tmp_path: Path, error: float, status: int) -> None:
    kept = Kept(tmp_path / "runs", WalkErrors)
    kept.folder.mkdir()
    made_up = WalkErrors(np.ones(4), np.full(4, 0.7), np.full(4, error))
    for task in tasks_of(DriftConfig(runs=8)):
        kept.save(task, made_up)
    command = ["study", "drift", "--quick", "--draw-only", "--out", str(tmp_path)]
    result = CliRunner().invoke(app, command)
    assert result.exit_code == status, result.output
    figures = json.loads((tmp_path / "summary.json").read_text("utf-8"))
    assert figures["ratio_1100mm_2x"] == pytest.approx(error)
    assert {path.name for path in tmp_path.iterdir()} == {
        "drift.png", "drift.svg", "drift.csv", "drift.md", "summary.json", "runs",
    }  # fmt: skip
