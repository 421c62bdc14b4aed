"""A small world explored by the whole chain, compared with what only the simulator knows."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from infomap_ros.cli.command_options import with_settings
from infomap_ros.exploration.loop import EndReason
from infomap_ros.exploration.records.recorded_run import RecordedRun, read_run
from infomap_ros.exploration.records.run_log import Progress
from infomap_ros.exploration.task import TaskConfig
from infomap_ros.mapping import VoxelMap
from infomap_ros.simulation.exploring.exploration_run import (
    ExplorationOptions,
    ExplorationRun,
    task_in,
)
from infomap_ros.simulation.exploring.visible_surface import (
    map_errors,
    surface_coverage,
    visible_surface,
)
from infomap_ros.simulation.worlds.scenes import make_world

SETTINGS = (
    "world.name=mars",
    "world.seed=2",
    "world.size=4.5",
    "task.max_views=8",
    "robot.pose_source=simulator",
    "robot.images_while_moving=false",
    "simulator.camera.width=320",
    "simulator.camera.height=240",
    "simulator.camera.supersampling=1",
)


@pytest.fixture(scope="module")
def explored(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[ExplorationRun, Path]]:
    """Eight views of a crater of 4.5 m, with all results."""
    out = tmp_path_factory.mktemp("explored")
    run = ExplorationRun(with_settings(ExplorationOptions(), SETTINGS), out)
    ending = run.run()
    assert ending.reason is EndReason.BUDGET_SPENT, ending.detail
    run.write_results(ending)
    yield run, out
    run.close()


def recorded(explored: tuple[ExplorationRun, Path]) -> RecordedRun:
    return read_run(explored[1] / "exploration.jsonl")


def test_it_drives_and_touches_nothing(explored: tuple[ExplorationRun, Path]) -> None:
    run, out = explored
    assert run.simulator.contact_events == ()
    summary = json.loads((out / "summary.json").read_text())
    assert summary["views"] == 8 and summary["contacts"] == 0
    assert summary["distance"] > 0.3


def test_most_of_what_can_be_seen_is_in_the_map(explored: tuple[ExplorationRun, Path]) -> None:
    run, _ = explored
    visible = visible_surface(run.simulator.world, run.options.planner.max_range)
    assert surface_coverage(run.map, visible.points) > 0.6


def test_the_map_is_as_wrong_as_it_says(explored: tuple[ExplorationRun, Path]) -> None:
    run, _ = explored
    errors = map_errors(run.map, run.simulator.world)
    assert errors.share_within(1.0) > 0.6
    assert errors.share_within(3.0) > 0.95


def test_the_log_and_the_files_tell_of_the_same_run(explored: tuple[ExplorationRun, Path]) -> None:
    run, out = explored
    log = recorded(explored)
    assert log.problems == ()
    known = [progress.known_fraction for progress in log.of(Progress)]
    assert {progress.views for progress in log.of(Progress)} == set(range(1, 9))
    assert known[-1] > known[0] + 0.2
    loaded = VoxelMap.load(out / "map.infomap")
    assert loaded.known_voxels == run.map.known_voxels
    assert (out / "report.html").stat().st_size > 100_000


def test_task_has_the_worlds_region_unless_another_was_asked_for() -> None:
    world = make_world("mars", 2, size=4.5)
    np.testing.assert_allclose(task_in(world, TaskConfig()).region, world.region)
    own = TaskConfig(region_low=(-1.0, -1.0, 0.0), region_high=(1.0, 1.0, 1.0))
    assert task_in(world, own) is own
