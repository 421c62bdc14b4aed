"""``infomap study rover``."""

import time
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer

from infomap_ros.cli.study_options import (
    DrawOnly,
    Jobs,
    Out,
    Quick,
    Strategies,
    chosen_strategies,
    finish,
    progress_bar,
    refusals,
    workers,
)
from infomap_ros.studies.rover_exploration import RoverExploration
from infomap_ros.studies.rover_study import (
    Results,
    RoverStudyConfig,
    complete,
    overview,
    quick,
    rows_of,
    summary,
    tasks_of,
)
from infomap_ros.studies.runs import Kept, run_all, write_lines, write_rows


def rover(
    out: Out,
    worlds: Annotated[int, typer.Option(help="seeded worlds")] = RoverStudyConfig.worlds,
    seed: Annotated[int, typer.Option(help="of the first world")] = RoverStudyConfig.seed,
    strategies: Strategies = "",
    raster_views: Annotated[
        int, typer.Option(help="views of the strategy raster")
    ] = RoverStudyConfig.raster_views,
    raster_worlds: Annotated[
        int, typer.Option(help="worlds where it does; elsewhere as many as the others")
    ] = RoverStudyConfig.raster_worlds,
    jobs: Jobs = 0,
    is_quick: Quick = False,
    draw_only: DrawOnly = False,
) -> None:
    """Figs. 17, 18: the rover in a rough world, largest information against raster scans.

    What is done is kept in OUT/runs, and not done again when the command is repeated.
    """
    from infomap_ros.studies.rover_study import all_figures

    with refusals():
        config = RoverStudyConfig(
            worlds=worlds, seed=seed, raster_views=raster_views, raster_worlds=raster_worlds
        )
        config = quick(config) if is_quick else config
        config = replace(config, strategies=chosen_strategies(strategies, config.strategies))
        tasks, start = tasks_of(config), time.monotonic()
        kept = Kept(out / "runs", RoverExploration)
        with progress_bar("explorations", len(tasks)) as advance:
            results = run_all(tasks, kept, workers(jobs), advance, compute=not draw_only)
    write_rows(rows_of(results, config), out / "rover.csv")
    _write_curves(results, out / "rover_curves.csv")
    results = complete(results)
    all_figures(results, config, out)
    seconds = time.monotonic() - start
    finish("rover", overview(results, config), summary(results, config, seconds), out)


def _write_curves(results: Results, path: Path) -> None:
    """Mapped points and distance after each view, one line each."""
    names = ["world", "strategy", "view", "points", "distance_m", "processor_s"]
    lines = [
        [task.seed, task.label, view, *map(float, row)]
        for task, result in results.items()
        for view, row in enumerate(
            zip(result.points, result.distance, result.seconds, strict=True), 1
        )
    ]
    write_lines(names, lines, path)
