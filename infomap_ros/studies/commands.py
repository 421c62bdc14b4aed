"""The studies on the command line: ``infomap study NAME``.

Each leaves its figures and ``summary.json``, one flat object, in the folder that it is given, and
exits with 1 when it does not find what is claimed.
"""

from __future__ import annotations

import json
import time
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.progress import Progress

from infomap_ros.studies.localization_commands import drift, pose_consistency
from infomap_ros.studies.map_consistency import ConsistencyConfig, run_study, summary, table
from infomap_ros.studies.metrics.commands import metrics
from infomap_ros.studies.planar.commands import planar, two
from infomap_ros.studies.rover.commands import rover

app = typer.Typer(help="Experiments with the package, and their figures.", no_args_is_help=True)
app.command("drift")(drift)
app.command("pose-consistency")(pose_consistency)
app.command("planar")(planar)
app.command("two")(two)
app.command("rover")(rover)
app.command("metrics")(metrics)


@app.callback()
def _studies() -> None:
    """Without it a single command would have no name."""


@app.command("map-consistency")
def map_consistency(
    out: Annotated[Path, typer.Option(help="folder for the results", show_default=False)],
    scenes: Annotated[int, typer.Option(help="random scenes")] = ConsistencyConfig.scenes,
    seed: Annotated[int, typer.Option(help="of the first scene")] = ConsistencyConfig.seed,
) -> None:
    """Is the map as sure as it should be? Its errors against its own covariances."""
    from infomap_ros.studies.consistency_figure import draw_histograms

    config = ConsistencyConfig(scenes=scenes, seed=seed)
    start = time.monotonic()
    with Progress(console=Console(stderr=True), transient=True) as progress:
        task = progress.add_task("scenes", total=scenes)
        results = run_study(config, lambda done: progress.update(task, completed=done))
    out.mkdir(parents=True, exist_ok=True)
    draw_histograms(results, out / "map_consistency.png")
    figures = summary(results, time.monotonic() - start)
    (out / "summary.json").write_text(json.dumps(figures) + "\n", encoding="utf-8")
    typer.echo(table(results))
    typer.echo(json.dumps(figures))
    raise typer.Exit(0 if all(result.is_consistent for result in results) else 1)
