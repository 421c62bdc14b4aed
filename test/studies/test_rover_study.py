"""The rover's study: its scans by rows, its figures and its command."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from infomap_ros.cli import app
from infomap_ros.geometry import PinholeCamera, make_transform
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.mapping import VoxelMap
from infomap_ros.studies.rover_exploration import (
    OneDirectionRaster,
    RoverExploration,
    RoverTask,
    SweepRaster,
)
from infomap_ros.studies.rover_study import (
    OWN,
    RoverStudyConfig,
    complete,
    overview,
    quick,
    ratio,
    rows_of,
    tasks_of,
)
from infomap_ros.studies.runs import Kept
from infomap_ros.views.sampling.orientations import look_rotations
from infomap_ros.views.situation import RegionOfTask, Situation


def made_up(points: list[float], mapped: int = 3) -> RoverExploration:
    views = len(points)
    distance = np.arange(views, dtype=np.float64)
    cameras = np.tile(np.eye(4), (views, 1, 1))
    surface = np.random.default_rng(1).normal(size=(9, 3)).astype(np.float32)
    first_seen = np.where(np.arange(9) < mapped, 1, 0).astype(np.int16)
    return RoverExploration(
        np.array(points), distance, distance, cameras, surface, first_seen, 0, "", "budget spent"
    )


def study() -> tuple[RoverStudyConfig, dict[RoverTask, RoverExploration]]:
    """Two worlds in which largest information maps 6 and 1.5 times as much after three views."""
    config = replace(quick(RoverStudyConfig()), worlds=2, views=3, raster_views=4)
    first, raster, second, other = tasks_of(config)
    return config, {
        first: made_up([1.0, 3.0, 6.0]),
        raster: made_up([1.0, 1.0]),
        second: made_up([1.0, 2.0, 3.0]),
        other: made_up([1.0, 1.5, 2.0, 6.0]),
    }


def test_ratios_are_paired_by_world() -> None:
    _, results = study()
    assert ratio(results, "raster", 3, 3).mean == pytest.approx(3.0)  # of 6 and 1.5
    assert ratio(results, "raster", 3, 4).mean == pytest.approx(3.0**0.5)  # of 6 and 0.5
    alone = {task: result for task, result in results.items() if task.seed == 1}
    assert ratio(alone, "raster", 3, 3).count == 1


def test_raster_is_compared_at_many_views_only_where_it_was_to_take_them() -> None:
    config, results = study()
    first, raster, second, other = tasks_of(replace(config, raster_worlds=1))
    assert (raster.views, other.views) == (4, 3)
    same = dict(zip((first, raster, second, other), results.values(), strict=True))
    found = ratio(same, "raster", 3, 4)
    assert (found.mean, found.count) == (pytest.approx(6.0), 1)
    assert ratio(same, "raster", 3, 3).count == 2


def test_tables_hold_the_worlds_that_all_strategies_have_explored() -> None:
    _, results = study()
    last = list(results)[-1]
    unfinished = {task: result for task, result in results.items() if task != last}
    assert [task.seed for task in complete(unfinished)] == [1, 1]
    assert complete(results) == results


def test_what_was_reached_at_the_end_stays() -> None:
    config, results = study()
    rows = rows_of(results, config)
    assert [row.points for row in rows] == [6.0, 1.0, 3.0, 2.0]
    assert [row.points_end for row in rows] == [6.0, 1.0, 3.0, 6.0]
    assert [row.views for row in rows] == [3, 2, 3, 4]
    assert "| raster | 2 |" in overview(results, config)


def test_explorations_end_by_their_budget_of_views_alone() -> None:
    own, raster, *_ = tasks_of(RoverStudyConfig())
    assert (own.strategy, own.options().task.max_views) == (OWN, 18)
    assert (raster.strategy, raster.options().task.max_views) == ("raster", 41)
    assert own.options().task.known_fraction == 1.0
    assert [each.options().task.unproductive_views for each in (own, raster)] == [18, 41]
    assert own.options().world == raster.options().world
    assert own.fingerprint() != raster.fingerprint()


def test_command_writes_tables_and_figures(tmp_path: Path) -> None:
    config, results = quick(RoverStudyConfig()), study()[1]
    kept = Kept(tmp_path / "runs", RoverExploration)
    kept.folder.mkdir()
    for task, result in zip(tasks_of(config), results.values(), strict=False):
        kept.save(task, result)
    arguments = ["study", "rover", "--out", str(tmp_path), "--quick", "--draw-only"]
    done = CliRunner().invoke(app, arguments)
    assert done.exit_code == 0, done.output
    figures = json.loads((tmp_path / "summary.json").read_text())
    assert figures["raster.factor_against_3"] == pytest.approx(6.0)
    names = {path.name for path in tmp_path.iterdir()}
    assert {"rover.csv", "rover.md", "rover_curves.csv", "rover_curves.png"} <= names
    assert {"rover_regions.png", "rover_regions.svg", "rover_curves.svg"} <= names


def looking(x: float, y: float, azimuth: float) -> FloatArray:
    rotation = look_rotations(np.array([azimuth]), np.zeros(1))[0]
    return make_transform(rotation, np.array([x, y, 0.5]))


def options_at(here: FloatArray, past_views: list[FloatArray], poses: FloatArray) -> Any:
    """What a scan that has looked from some poses chooses among in an empty map."""
    situation = Situation(
        VoxelMap(),
        PinholeCamera(64, 48, 40.0, 40.0, 31.5, 23.5),
        4.0,
        here,
        region=RegionOfTask(np.array([-2.0, -2.0, 0.0]), np.array([2.0, 2.0, 1.0])),
        past_views=np.array(past_views),
    )
    surroundings = SimpleNamespace(voxel_size=0.05)
    return SimpleNamespace(situation=situation, surroundings=surroundings, poses=poses)


def test_sweep_goes_on_along_its_row_and_keeps_its_heading() -> None:
    here, views = looking(0.2, 0.2, 0.3), [(1.8, 0.2), (0.6, 0.2), (-0.2, 0.2), (0.6, 0.2)]
    turns = (0.3, 2.0, 0.3, 0.4)
    poses = np.array([looking(*place, turn) for place, turn in zip(views, turns, strict=True)])
    options = options_at(here, [here], poses)
    ratings: Any = None
    values = SweepRaster().score(options, ratings).values
    # this row runs towards -x: one step ahead; then from the row's begin; then the smaller turn
    assert list(np.argsort(-values)) == [2, 0, 3, 1]
    options = options_at(here, [here, poses[2]], poses)
    assert list(np.argsort(-SweepRaster().score(options, ratings).values)) == [0, 3, 1, 2]


def test_one_direction_scan_turns_only_where_no_view_is_left_in_it() -> None:
    first, here = looking(0.2, 0.2, 0.3), looking(0.6, 0.2, 0.5)
    poses = np.array([looking(-0.6, 0.2, 0.6), looking(-0.2, 0.2, 2.0), looking(-1.0, 0.2, 0.2)])
    options = options_at(here, [first, here], poses)
    ratings: Any = None
    values = OneDirectionRaster().score(options, ratings).values
    # the row runs towards -x; the next place, from which the camera would turn, comes last
    assert list(np.argsort(-values)) == [0, 2, 1]
    assert list(np.argsort(-SweepRaster().score(options, ratings).values)) == [1, 0, 2]
