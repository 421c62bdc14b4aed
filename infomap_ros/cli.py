"""Command line ``infomap``, also for machines without ROS."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Annotated, Optional

import typer
from rich.console import Console
from threadpoolctl import threadpool_limits

from infomap_ros.errors import ExplorationError, InfomapError
from infomap_ros.exploration.loop import EndReason
from infomap_ros.localization.target.draw_target_command import draw_target
from infomap_ros.mapping import VoxelMap
from infomap_ros.replay.commands.command_options import Out, Setting
from infomap_ros.replay.commands.settings import with_settings
from infomap_ros.replay.localizing.localize_command import localize
from infomap_ros.replay.mapping.map_command import map_bag
from infomap_ros.replay.mapping.map_inputs import MapOptions
from infomap_ros.replay.sequences import FORMATS
from infomap_ros.replay.sequences import convert as convert_sequence
from infomap_ros.studies.commands import app as studies

app = typer.Typer(
    help="Stereo images to a probabilistic 3-D map with honest uncertainty.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode="markdown",  # leaves the brackets of units alone
    add_completion=False,
)
app.add_typer(studies, name="study")
app.command("map")(map_bag)
app.command("localize")(localize)
app.command("draw-target")(draw_target)
_PASSED_ON = {
    "allow_extra_args": True,
    "ignore_unknown_options": True,
    "help_option_names": [],  # --help is the other command's
}


@app.command()
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
    from infomap_ros.simulation.exploring.exploration_run import ExplorationOptions, ExplorationRun
    from infomap_ros.simulation.exploring.run_progress import RunProgress

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


@app.command()
def show(
    map_file: Annotated[Path, typer.Argument(help="a map file", show_default=False)],
    out: Annotated[Optional[Path], typer.Option(help="picture to write (.png)")] = None,
) -> None:
    """Print what a map file holds, and draw it."""
    from infomap_ros.mapping.files.pictures import draw_map_views

    voxel_map = VoxelMap.load(map_file)
    bounds, size = voxel_map.bounds(), voxel_map.config.voxel_size
    figures = {
        "voxel_size": size,
        "known_voxels": voxel_map.known_voxels,
        "surface_voxels": voxel_map.surface_voxels,
        "entropy_bits": round(voxel_map.entropy_bits(), 1),
        "memory_bytes": voxel_map.memory_bytes(),
        "low": None if bounds is None else (bounds[0] * size).round(3).tolist(),
        "high": None if bounds is None else ((bounds[1] + 1) * size).round(3).tolist(),
    }
    picture = (out or map_file).with_suffix(".png")
    draw_map_views(voxel_map, picture)
    typer.echo(json.dumps(figures | {"picture": str(picture)}))


@app.command()
def convert(
    form: Annotated[str, typer.Argument(metavar="FORMAT", help=", ".join(FORMATS))],
    folder: Annotated[Path, typer.Argument(help="where the sequence is", show_default=False)],
    out: Annotated[Path, typer.Argument(help="folder of the bag", show_default=False)],
    overwrite: Annotated[bool, typer.Option(help="replace a bag that is there")] = False,
) -> None:
    """Turn a recorded sequence into a bag."""
    count = convert_sequence(form, folder, out, overwrite)
    typer.echo(json.dumps({"bag": str(out), "messages": count}))


@app.command("record-demo-bag", context_settings=_PASSED_ON)
def record_demo_bag(context: typer.Context) -> None:
    """Record a stereo bag in simulation."""
    from infomap_ros.simulation.recorder import main as record

    record(context.args)


@app.command("calibrate-noise")
def calibrate_noise(
    folders: Annotated[
        list[Path], typer.Argument(help="folders of pairs with true disparity", show_default=False)
    ],
    out: Annotated[Path, typer.Option(help="folder for plot and summary.json", show_default=False)],
    setting: Annotated[
        Optional[list[str]],
        typer.Option("--set", metavar="stereo.NAME=VALUE", help="of the sensor"),
    ] = None,
    half_sizes: Annotated[bool, typer.Option(help="fit to the pairs at half size too")] = True,
) -> None:
    """Fit the noise models of the stereo sensor to pairs with true disparity."""
    from infomap_ros.stereo import calibration
    from infomap_ros.stereo.ground_truth import load_pairs
    from infomap_ros.stereo.noise_plot import draw_noise_fit

    config = with_settings(MapOptions(), setting or []).stereo
    pairs = [pair for folder in folders for pair in load_pairs(folder)]
    fit = calibration.calibrate_noise(pairs, config, half_sizes=half_sizes)
    out.mkdir(parents=True, exist_ok=True)
    draw_noise_fit(fit, out / "noise.png")
    summary = fit.summary()
    (out / "summary.json").write_text(json.dumps(summary, indent=1) + "\n", encoding="utf-8")
    typer.echo(fit.table())
    typer.echo(json.dumps(summary))


@app.command(context_settings=_PASSED_ON)
def doctor(context: typer.Context) -> None:
    """Say what a live ROS graph lacks."""
    try:
        from infomap_ros.nodes.diagnosis.doctor import main as examine
    except ModuleNotFoundError as error:
        raise InfomapError(f"the doctor needs ROS 2, and there is no {error.name}") from error
    raise typer.Exit(examine(context.args))


def main() -> None:
    """Run the command line; errors end it with one line and exit status 1."""
    threadpool_limits(1, user_api="blas")  # its threads spin, and slow down small problems
    try:
        app()
    except (InfomapError, OSError) as error:
        sys.exit(f"infomap: {error}")
    except KeyboardInterrupt:
        sys.exit("infomap: interrupted")


if __name__ == "__main__":
    main()
