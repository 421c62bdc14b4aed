"""``infomap study metrics``."""

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
    finish,
    progress_bar,
    refusals,
    workers,
)
from infomap_ros.studies.common.runs import Kept, run_all
from infomap_ros.studies.common.tables import write_lines, write_rows
from infomap_ros.studies.metrics.metric_run import MetricRun
from infomap_ros.studies.metrics.metrics_study import (
    MetricsStudyConfig,
    Results,
    comparisons,
    complete,
    overview,
    rows_of,
    summary,
    tasks_of,
)
from infomap_ros.studies.metrics.unknown import unknown_shares, values_by_share


def metrics(
    out: Out,
    worlds: Annotated[int, typer.Option(help="of each kind")] = MetricsStudyConfig.worlds,
    seed: Annotated[int, typer.Option(help="of the first world")] = MetricsStudyConfig.seed,
    names: Annotated[str, typer.Option("--metrics", help="names, with commas; all if empty")] = "",
    jobs: Jobs = 0,
    is_quick: Quick = False,
    draw_only: DrawOnly = False,
) -> None:
    """Every information metric in the same loop and worlds, with the same strategy.

    What is done is kept in OUT/runs, and not done again when the command is repeated.
    """
    from infomap_ros.studies.metrics.figures import draw_curves, draw_unknown

    with refusals():
        config = MetricsStudyConfig(worlds=worlds, seed=seed)
        if is_quick:
            kinds = config.kinds[:1]
            config = replace(config, worlds=1, kinds=kinds, scans=8, candidates=60)
        if names:
            config = replace(config, metrics=tuple(names.split(",")))
        tasks, start = tasks_of(config), time.monotonic()
        kept = Kept(out / "runs", MetricRun)
        with progress_bar("explorations", len(tasks)) as advance:
            results = run_all(tasks, kept, workers(jobs), advance, compute=not draw_only)
    write_rows(rows_of(results, config), out / "metrics.csv")
    _write_curves(results, out / "metrics_curves.csv")
    results = complete(results)
    rows = rows_of(results, config)
    draw_curves(results, config, out / "metrics_curves")
    shares = unknown_shares()
    values = values_by_share(shares)
    lines = [[float(v) for v in row] for row in zip(shares, *values.values(), strict=True)]
    write_lines(["unknown_share", *values], lines, out / "metrics_unknown.csv")
    draw_unknown(shares, values, out / "metrics_unknown")
    tables = overview(rows, config) + "\n" + comparisons(rows, config)
    finish("metrics", tables, summary(rows, time.monotonic() - start), out)


def _write_curves(results: Results, path: Path) -> None:
    """Figures after each scan, one line each."""
    columns = ("fraction", "distance", "bits", "wrong", "seconds")
    lines = [
        [str(task.world), task.metric, scan, *map(float, values)]
        for task, run in results.items()
        for scan, values in enumerate(
            zip(*(getattr(run, name) for name in columns), strict=True), 1
        )
    ]
    names = ["world", "metric", "scan", "fraction", "distance_m", "bits", "wrong", "processor_s"]
    write_lines(names, lines, path)
