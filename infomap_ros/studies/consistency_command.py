"""Command ``infomap study map-consistency``."""

import json
import time
from typing import Annotated

import typer
from rich.console import Console
from rich.progress import Progress

from infomap_ros.studies.common.command_line import Out
from infomap_ros.studies.consistency_figure import draw_histograms
from infomap_ros.studies.map_consistency import ConsistencyConfig, run_study, summary, table


def map_consistency(
    out: Out,
    scenes: Annotated[int, typer.Option(help="random scenes")] = ConsistencyConfig.scenes,
    seed: Annotated[int, typer.Option(help="of the first scene")] = ConsistencyConfig.seed,
) -> None:
    """Is the map as sure as it should be? Its errors against its own covariances."""
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
