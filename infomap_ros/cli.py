"""Command line ``infomap``, also for machines without ROS."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Annotated, Optional

import typer
from rich.console import Console
from threadpoolctl import threadpool_limits

from infomap_ros.errors import CapacityError, ExplorationError, InfomapError
from infomap_ros.exploration.loop import EndReason
from infomap_ros.localization.target.draw_target_command import draw_target
from infomap_ros.mapping import VoxelMap
from infomap_ros.replay.localize_command import localize
from infomap_ros.replay.map_inputs import MapOptions
from infomap_ros.replay.map_run import MapRun
from infomap_ros.replay.progress_bar import run_with_bar
from infomap_ros.replay.reader import BagReader
from infomap_ros.replay.sequences import FORMATS
from infomap_ros.replay.sequences import convert as convert_sequence
from infomap_ros.replay.settings import setting_names, with_settings
from infomap_ros.studies.commands import app as studies

app = typer.Typer(
    help="Stereo images to a probabilistic 3-D map with honest uncertainty.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    add_completion=False,
)
app.add_typer(studies, name="study")
app.command("localize")(localize)
app.command("draw-target")(draw_target)
_PASSED_ON = {
    "allow_extra_args": True,
    "ignore_unknown_options": True,
    "help_option_names": [],  # --help is the other command's
}
_Topic = Annotated[str, typer.Option(show_default=False, metavar="TOPIC", rich_help_panel="Topics")]


def _list_settings(wanted: bool) -> None:
    if wanted:
        typer.echo("\n".join(setting_names(MapOptions())))
        raise typer.Exit


@app.command("map")
def map_bag(
    bag: Annotated[
        Path, typer.Argument(help="rosbag2 folder, .mcap, .db3, or ROS 1 .bag", show_default=False)
    ],
    out: Annotated[Path, typer.Option(help="folder for the results", show_default=False)],
    voxel_size: Annotated[Optional[float], typer.Option(help="edge of a voxel [m]")] = None,
    max_range: Annotated[Optional[float], typer.Option(help="farthest mapped point [m]")] = None,
    source: Annotated[Optional[str], typer.Option(help="auto, stereo or depth")] = None,
    rectify: Annotated[Optional[str], typer.Option(help="auto, yes or no")] = None,
    poses: Annotated[Optional[str], typer.Option(help="auto, bag or localize")] = None,
    left_image: _Topic = "",
    right_image: _Topic = "",
    left_info: _Topic = "",
    right_info: _Topic = "",
    depth: _Topic = "",
    info: _Topic = "",
    pose_topic: _Topic = "",
    joints: _Topic = "",
    map_frame: Annotated[Optional[str], typer.Option(help="frame of the map")] = None,
    pose_frame: Annotated[
        Optional[str], typer.Option(help="whose pose the pose topic tells")
    ] = None,
    robot: Annotated[
        str, typer.Option(help="URDF file, in place of the bag's", metavar="URDF")
    ] = "",
    setting: Annotated[
        Optional[list[str]], typer.Option("--set", metavar="SECTION.NAME=VALUE", help="any setting")
    ] = None,
    settings: Annotated[
        bool, typer.Option("--settings", callback=_list_settings, is_eager=True, help="list them")
    ] = False,
) -> None:
    """Map a recorded bag: map file, .ply, pictures and summary.json."""
    del settings  # the callback has answered it
    shortcuts = {
        "map.voxel_size": voxel_size,
        "map.max_range": max_range,
        "input.source": source,
        "input.rectify": rectify,
        "input.poses": poses,
        "input.map_frame": map_frame,
        "input.pose_frame": pose_frame,
    }
    given = [f"{name}={value}" for name, value in shortcuts.items() if value is not None]
    topics = {
        "left_image": left_image,
        "right_image": right_image,
        "left_info": left_info,
        "right_info": right_info,
        "depth": depth,
        "info": info,
        "pose": pose_topic,
        "joints": joints,
    }
    options = with_settings(MapOptions(topics=topics, robot=robot), given + (setting or []))
    _map(bag, out, options)


def _map(bag: Path, out: Path, options: MapOptions) -> None:
    from infomap_ros.replay.map_files import write_map_files

    with BagReader(bag) as reader:
        run = MapRun(reader, options)
        run_with_bar(run.run, "mapping", "frames", run.inputs.frames)
        summary = write_map_files(run, out)
        for text in _remarks(run, reader):
            typer.echo(f"infomap: {text}", err=True)
    typer.echo(json.dumps(summary))
    if run.full:
        raise CapacityError(f"the map is full, what came later is not in it: {run.full}")


def _remarks(run: MapRun, reader: BagReader) -> list[str]:
    """What the user should know beside the figures."""
    remarks = list(reader.problems)
    remarks += [f"{count} messages skipped: {text}" for text, count in reader.skipped.items()]
    remarks += [f"{count} frames dropped: {text}" for text, count in run.dropped.items()]
    remarks += [f"{count} poses refused: {text}" for text, count in run.refused.items()]
    if run.assumed_poses:
        remarks.append(
            f"{run.inputs.pose_topic} has no covariance: assumed.default_position_sigma and "
            "assumed.default_rotation_sigma stand in for it"
        )
    return remarks


@app.command()
def explore(
    out: Annotated[Path, typer.Option(help="folder for the results", show_default=False)],
    world: Annotated[str, typer.Option(help="mars, office or cave")] = "mars",
    seed: Annotated[int, typer.Option(help="of the world and of all noise")] = 1,
    strategy: Annotated[
        Optional[str], typer.Option(help="name of a strategy, or a class by its dotted path")
    ] = None,
    setting: Annotated[
        Optional[list[str]], typer.Option("--set", metavar="SECTION.NAME=VALUE", help="any setting")
    ] = None,
) -> None:
    """Explore a simulated world: map file, .ply, report.html and summary.json."""
    from infomap_ros.simulation.exploration_run import ExplorationOptions, ExplorationRun
    from infomap_ros.simulation.run_progress import RunProgress

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
        from infomap_ros.nodes.doctor import main as examine
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
