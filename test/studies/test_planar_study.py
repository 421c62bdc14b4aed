"""The planar study as a whole: its loop, its files, its command, and a strategy of one's own."""

from __future__ import annotations

import csv
import json
import re
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from infomap_ros.cli import app
from infomap_ros.errors import ConfigError
from infomap_ros.mapping import VoxelMap
from infomap_ros.studies.planar.explore import (
    INFORMATION,
    Exploration,
    ExplorationConfig,
    explore,
    explore_together,
)
from infomap_ros.studies.planar.planar_study import (
    BASELINES,
    PlanarStudyConfig,
    complete,
    quick,
    tasks_of,
)
from infomap_ros.studies.planar.tasks import Record, run_tasks
from infomap_ros.studies.planar.world import (
    PlanarWorld,
    SensorConfig,
    level_pose,
    make_world,
    take_scan,
)
from infomap_ros.studies.runs import Kept
from infomap_ros.views.information.view_information import ExpectedInformation
from infomap_ros.views.ranking.options import Options
from infomap_ros.views.ranking.rating import Ratings
from infomap_ros.views.ranking.strategy import Scores
from infomap_ros.views.situation import Situation

TUTORIAL = Path(__file__).resolve().parents[2] / "docs" / "tutorial_own_strategy.md"
SHORT = ExplorationConfig(scans=5)


@pytest.fixture(scope="module")
def world() -> PlanarWorld:
    return make_world("caves", 1, 1.0)


def mapped_by(world: PlanarWorld, views: np.ndarray) -> float:
    """Fraction mapped by scans from given views."""
    sensor = SensorConfig()
    voxel_map = VoxelMap(sensor.map_config(world.cell))
    for x, y, azimuth in views:
        pose = level_pose(np.array([x, y]), azimuth, world.cell)
        take_scan(world.truth, sensor, pose, voxel_map)
    return world.fraction_mapped(voxel_map)


@pytest.mark.parametrize("strategy", ["look_ahead", *BASELINES])
def test_every_strategy_explores(world: PlanarWorld, strategy: str) -> None:
    found = explore(world, strategy, SHORT)
    assert len(found.fraction) == 5
    assert (np.diff(found.fraction) >= 0.0).all() and found.fraction[-1] > found.fraction[0]
    assert found.fraction[-1] == pytest.approx(mapped_by(world, found.views), abs=1e-12)
    steps = np.linalg.norm(np.diff(found.corners, axis=0), axis=1)
    assert found.distance[-1] == pytest.approx(steps.sum(), rel=1e-9)
    samples = np.concatenate(
        [
            a + np.linspace(0.0, 1.0, 50)[:, None] * (b - a)
            for a, b in zip(found.corners[:-1], found.corners[1:], strict=True)
        ]
    )
    cells = np.floor(samples / world.cell).astype(int)
    assert not world.occupied[tuple(cells.T)].mean() > 0.01  # corners may be grazed


def test_same_seed_same_exploration(world: PlanarWorld) -> None:
    first, again = explore(world, "look_ahead", SHORT), explore(world, "look_ahead", SHORT)
    np.testing.assert_array_equal(first.views, again.views)
    other = explore(world, "look_ahead", replace(SHORT, seed=1))
    assert not np.array_equal(first.views, other.views)


@pytest.mark.parametrize(
    ("scans", "fraction", "distance", "end"),
    [
        (3, 0.95, 0.0, "enough is mapped"),
        (5, 0.5, 9.0, ""),  # not far enough
        (4, 0.5, 11.0, ""),  # too few scans
        (5, 0.5, 11.0, "the figures are full"),
        (8, 0.5, 9.0, "all scans are taken"),
    ],
)
def test_explorations_end(scans: int, fraction: float, distance: float, end: str) -> None:
    config = ExplorationConfig(scans=8, enough=0.9, min_scans=5, min_path_length=10.0)
    assert config.end(scans, fraction, distance) == end


def test_only_worlds_that_all_have_explored_are_compared() -> None:
    config = PlanarStudyConfig(worlds=1, strategies=("random", "raster"))
    nothing = Exploration(*[np.zeros(1)] * 5, ended="")
    records = [Record(task, nothing) for task in tasks_of(config)]
    assert complete(records) == records
    assert complete(records[:5]) == records[:4]


class Watching:
    """Takes the view with the largest rating, and keeps what it is asked."""

    requires_positive_utility = False

    def __init__(self) -> None:
        self.asked: list[Situation] = []

    def score(self, options: Options, ratings: Ratings) -> Scores:
        self.asked.append(options.situation)
        return Scores(ratings.ratings)


def test_what_a_view_promised_in_vain_is_not_expected_again(world: PlanarWorld) -> None:
    strategy, information = Watching(), ExpectedInformation(config=INFORMATION)
    explore(
        world,
        strategy,
        replace(SHORT, scans=7),
        look_limit=0.01,
    )
    promised, again = 0.0, 0.0
    for situation in strategy.asked:
        pose = situation.T_map_camera[None]
        left = information.gains(replace(situation, promising=None), pose)[0]
        still = information.gains(situation, pose)[0]
        promised += left.total
        again += float(still.gains[np.isin(still.keys, left.keys)].sum())
    assert promised > 1.0
    assert again < 0.25 * promised  # of voxels at the very end of the range


def test_only_the_own_strategies_give_voxels_up() -> None:
    strategies = (*PlanarStudyConfig.strategies, "my_strategy.Thrifty")
    tasks = tasks_of(PlanarStudyConfig(worlds=0, strategies=strategies))
    with_it = [task for task in tasks if task.look_limit is not None]
    assert [task.label for task in with_it] == ["largest_information", "look_ahead", "Thrifty"]
    without = replace(with_it[0], look_limit=None)
    assert "look_limit" in with_it[0].fingerprint() and "look_limit" not in without.fingerprint()


def test_results_are_kept_and_not_computed_again(tmp_path: Path) -> None:
    config = replace(quick(PlanarStudyConfig()), strategies=("random",), scans=3, worlds=0)
    (task,) = tasks_of(config)
    done: list[int] = []
    (record,) = run_tasks([task], tmp_path, 1, done.append)
    written = (tmp_path / task.file_name).stat().st_mtime_ns
    (again,) = run_tasks([task], tmp_path, 1, done.append)
    assert done == [0, 1, 1]
    assert (tmp_path / task.file_name).stat().st_mtime_ns == written
    np.testing.assert_array_equal(again.result.views, record.result.views)
    assert again.result.ended == record.result.ended
    kept = Kept(tmp_path, Exploration)
    assert kept.load(replace(task, candidates=77)) is None  # other settings


def test_sensors_of_a_team_share_what_they_map(world: PlanarWorld) -> None:
    sensor = SensorConfig(field_of_view=75.0, max_range=10.0)
    config = ExplorationConfig(scans=8, sensor=sensor)
    together = explore_together(world, "largest_information", config)
    alone = explore(world, "largest_information", replace(config, scans=4))
    assert len(together.fraction) == 8
    assert len(together.views) == 4  # of the first sensor
    assert (np.diff(together.fraction) >= 0.0).all()
    assert together.fraction[-1] > alone.fraction[-1]


def test_command_leaves_tables_and_figures(tmp_path: Path, monkeypatch) -> None:
    """With the strategy of the tutorial, in a file of its own, by its dotted name."""
    (listing,) = re.findall(r"```python\n(.*?)```", TUTORIAL.read_text(), re.DOTALL)
    (tmp_path / "my_strategy.py").write_text(listing)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", list(sys.path))
    command = ["study", "planar", "--quick", "--worlds", "0", "--jobs", "1", "--out", "out"]
    strategies = "largest_information,my_strategy.Thrifty"
    result = CliRunner().invoke(app, [*command, "--strategies", strategies])
    assert result.exit_code == 0, result.output
    for name in ("planar_curves", "planar_by_kind", "planar_paths"):
        assert (tmp_path / "out" / f"{name}.png").stat().st_size > 5000
        assert (tmp_path / "out" / f"{name}.svg").read_text().startswith("<?xml")
    with (tmp_path / "out" / "planar.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [row["strategy"] for row in rows] == ["largest_information", "Thrifty"]
    figures = json.loads((tmp_path / "out" / "summary.json").read_text())
    assert figures["Thrifty.fraction"] == pytest.approx(float(rows[1]["fraction"]), abs=1e-4)
    assert "| Thrifty |" in (tmp_path / "out" / "planar.md").read_text()


def test_unknown_strategies_are_refused_in_one_line(world: PlanarWorld) -> None:
    with pytest.raises(ConfigError, match="no_such_module"):
        explore(world, "no_such_module.Strategy", SHORT)
