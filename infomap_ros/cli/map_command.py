"""Command ``infomap map``."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Optional

import typer

from infomap_ros.cli.command_options import (
    IMAGE_TOPICS,
    Bag,
    Out,
    Rectify,
    Setting,
    Source,
    Urdf,
    given_settings,
    lists_settings,
    takes_topics,
)
from infomap_ros.cli.progress_bar import run_with_bar
from infomap_ros.cli.settings import with_settings
from infomap_ros.errors import CapacityError
from infomap_ros.replay.bags.reader import BagReader
from infomap_ros.replay.mapping.map_inputs import MapOptions
from infomap_ros.replay.mapping.map_run import MapRun


@takes_topics(*IMAGE_TOPICS, "pose_topic", "joints")
def map_bag(
    bag: Bag,
    out: Out,
    topics: Mapping[str, str],
    voxel_size: Annotated[Optional[float], typer.Option(help="edge of a voxel [m]")] = None,
    max_range: Annotated[Optional[float], typer.Option(help="farthest mapped point [m]")] = None,
    source: Source = None,
    rectify: Rectify = None,
    poses: Annotated[Optional[str], typer.Option(help="auto, bag or localize")] = None,
    map_frame: Annotated[Optional[str], typer.Option(help="frame of the map")] = None,
    pose_frame: Annotated[
        Optional[str], typer.Option(help="whose pose the pose topic tells")
    ] = None,
    robot: Urdf = "",
    setting: Setting = None,
    settings: Annotated[
        bool,
        typer.Option(
            "--settings", callback=lists_settings(MapOptions), is_eager=True, help="list them"
        ),
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
    given = given_settings(shortcuts, setting)
    options = with_settings(MapOptions(topics=topics, robot=robot), given)
    _map(bag, out, options)


def _map(bag: Path, out: Path, options: MapOptions) -> None:
    from infomap_ros.replay.mapping.map_files import write_map_files

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
    if run.builder.assumed_poses:
        remarks.append(
            f"{run.inputs.pose_topic} has no covariance: assumed.default_position_sigma and "
            "assumed.default_rotation_sigma stand in for it"
        )
    return remarks
