"""Command ``infomap explore``."""

import json
from typing import Annotated, Optional

import typer
from rich.console import Console

from infomap_ros.cli.command_options import Out, Setting
from infomap_ros.cli.settings import with_settings
from infomap_ros.errors import ExplorationError
from infomap_ros.exploration.loop import EndReason
from infomap_ros.simulation.exploring.exploration_run import ExplorationOptions, ExplorationRun
from infomap_ros.simulation.exploring.run_progress import RunProgress


def explore(
    out: Out,
    world: Annotated[str, typer.Option(help="mars, office or cave")] = "mars",
    seed: Annotated[int, typer.Option(help="of the world and of all noise")] = 1,
    strategy: Annotated[
        Optional[str], typer.Option(help="name of a strategy, or a class by its dotted path")
    ] = None,
    setting: Setting = None,
) -> None:
    """Explore a simulated world: map file, .ply, report.html and summary.json."""
    given = [f"world.name={world}", f"world.seed={seed}"]
    given += [] if strategy is None else [f"planner.strategy={strategy}"]
    options = with_settings(ExplorationOptions(), given + (setting or []))
    with RunProgress(Console(stderr=True)) as progress:
        run = ExplorationRun(options, out, progress.show)
        ending = run.run()
    summary = run.write_results(ending)
    run.close()
    typer.echo(json.dumps(summary))
    if ending.reason is EndReason.FAILED:
        raise ExplorationError(ending.detail)
