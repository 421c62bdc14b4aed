"""The comparison of metrics: what is measured, and what the metrics say of the unknown."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from infomap_ros.cli import app
from infomap_ros.cli.study_metrics import values_by_share
from infomap_ros.mapping import VoxelMap
from infomap_ros.studies.metrics_study import (
    OWN,
    MetricRun,
    MetricsStudyConfig,
    complete,
    difference,
    overview,
    result_of_scans,
    rows_of,
    tasks_of,
)
from infomap_ros.studies.planar.explore import ExplorationConfig, explore
from infomap_ros.studies.planar.world import SensorConfig, level_pose, make_world, take_scan
from infomap_ros.studies.runs import Kept

PRINTED = ("scene_entropy", "stretched_scene_entropy", "weighted_scene_entropy")


def made_up(fraction: list[float], step: float) -> MetricRun:
    scans = len(fraction)
    zeros = np.zeros(scans)
    distance = np.linspace(0.0, step * (scans - 1), scans)
    views = np.zeros((scans, 3))
    return MetricRun(np.array(fraction), distance, zeros, zeros, zeros, views, "all scans")


def test_bits_and_wrong_cells_are_those_of_the_map() -> None:
    world, sensor = make_world("clutter", 3, 1.0), SensorConfig()
    x, y = world.start
    views = np.array([[x, y, 0.0], [x, y, 2.0]])
    bits, wrong = result_of_scans(world, sensor, views)
    voxel_map = VoxelMap(sensor.map_config(1.0))
    for place_x, place_y, azimuth in views:
        pose = level_pose(np.array([place_x, place_y]), azimuth, 1.0)
        take_scan(world.truth, sensor, pose, voxel_map)
    removed, mistaken, known = 0.0, 0, 0
    for i, j in np.argwhere(world.mappable):
        place = np.array([[i + 0.5, j + 0.5, 0.5]])
        p = float(voxel_map.probability(place)[0])
        removed += 1.0 + p * np.log2(p) + (1.0 - p) * np.log2(1.0 - p)
        if voxel_map.is_known(place)[0]:
            known, mistaken = known + 1, mistaken + ((p > 0.5) != world.occupied[i, j])
    assert bits[1] == pytest.approx(removed, rel=1e-3)
    assert wrong[1] == pytest.approx(mistaken / known)
    assert 0.0 < bits[0] < bits[1]


def test_printed_metrics_say_nothing_of_a_wholly_unknown_view() -> None:
    values = values_by_share(np.array([0.4, 0.8, 1.0]))
    for metric in PRINTED:
        assert values[metric][2] == pytest.approx(0.0, abs=1e-9)
        assert values[metric][1] > 0.1
    own = values["expected_entropy_reduction"]
    assert own[0] < own[1] < own[2]


def test_metric_decides_which_views_are_chosen() -> None:
    world, config = make_world("clutter", 0, 1.0), ExplorationConfig(scans=4)
    own, other = (
        explore(world, "largest_information", config, metric=m) for m in (OWN, PRINTED[0])
    )
    np.testing.assert_array_equal(own.views[0], other.views[0])
    assert not np.array_equal(own.views, other.views)


def test_areas_are_means_of_the_curves_and_paired_by_world() -> None:
    metrics = (OWN, "scene_entropy")
    config = MetricsStudyConfig(kinds=("caves",), worlds=2, metrics=metrics, scans=4, reach=4.0)
    curves = ([0.0, 0.4, 0.8, 0.8], [0.0, 0.2, 0.2, 0.4], [0.2, 0.6], [0.1, 0.1, 0.1, 0.1])
    runs = [made_up(fraction, 1.0) for fraction in curves]
    rows = rows_of(dict(zip(tasks_of(config), runs, strict=True)), config)
    assert [row.area_scans for row in rows] == pytest.approx([0.5, 0.2, 0.5, 0.1])
    assert [row.area_path for row in rows] == pytest.approx([0.5, 0.2, 0.5, 0.1])
    found = difference(rows, "scene_entropy", "area_scans")
    assert found.mean == pytest.approx(-0.35)
    assert found.count == 2
    line = next(t for t in overview(rows, config).splitlines() if f"`{OWN}`" in t)
    assert line.split("|")[3].strip() == "50.0 ± 0.0"


def test_tables_hold_the_worlds_in_which_all_metrics_chose() -> None:
    config = MetricsStudyConfig(kinds=("caves",), worlds=2, metrics=(OWN, "scene_entropy"))
    results = {task: made_up([0.1, 0.2], 1.0) for task in tasks_of(config)[:3]}
    assert [str(task.world) for task in complete(results)] == ["caves_0", "caves_0"]


def test_command_writes_tables_and_figures(tmp_path: Path) -> None:
    kinds = MetricsStudyConfig().kinds[:1]
    config = replace(MetricsStudyConfig(), worlds=1, kinds=kinds, scans=8, candidates=60)
    kept = Kept(tmp_path / "runs", MetricRun)
    kept.folder.mkdir()
    for number, task in enumerate(tasks_of(config)):
        kept.save(task, made_up([0.01 * number] * 8, 5.0))
    arguments = ["study", "metrics", "--out", str(tmp_path), "--quick", "--draw-only"]
    done = CliRunner().invoke(app, arguments)
    assert done.exit_code == 0, done.output
    figures = json.loads((tmp_path / "summary.json").read_text())
    assert figures["area_factor.fraction"] == pytest.approx(0.1)
    names = {path.name for path in tmp_path.iterdir()}
    assert {"metrics.csv", "metrics.md", "metrics_curves.csv", "metrics_unknown.csv"} <= names
    assert {"metrics_curves.png", "metrics_curves.svg", "metrics_unknown.png"} <= names
