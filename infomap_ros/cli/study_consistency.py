"""Command ``infomap study map-consistency``."""

import time
from typing import Annotated

import typer

from infomap_ros.cli.study_options import Out, finish, progress_bar, refusals
from infomap_ros.studies.consistency_figure import draw_histograms
from infomap_ros.studies.map_consistency import ConsistencyConfig, run_study, summary, table


def map_consistency(
    out: Out,
    scenes: Annotated[int, typer.Option(help="random scenes")] = ConsistencyConfig.scenes,
    scans: Annotated[
        int, typer.Option(help="scans of each sequence with shared errors")
    ] = ConsistencyConfig.scans,
    seed: Annotated[int, typer.Option(help="of the first scene")] = ConsistencyConfig.seed,
) -> None:
    """Is the map as sure as it should be? Its errors against its own covariances."""
    start = time.monotonic()
    with refusals(), progress_bar("scenes", scenes) as advance:
        results = run_study(ConsistencyConfig(scenes=scenes, scans=scans, seed=seed), advance)
    out.mkdir(parents=True, exist_ok=True)
    draw_histograms(results, out / "map_consistency.png")
    figures = summary(results, time.monotonic() - start)
    finish("map_consistency", table(results), figures, out)
    raise typer.Exit(0 if all(result.is_consistent for result in results) else 1)
