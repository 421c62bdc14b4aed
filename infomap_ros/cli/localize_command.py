"""Command ``infomap localize``."""

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
from infomap_ros.replay.bags.reader import BagReader
from infomap_ros.replay.localizing.localize_inputs import LocalizeOptions
from infomap_ros.replay.localizing.localize_run import LocalizeRun


@takes_topics(*IMAGE_TOPICS, "color", "odometry", "joints")
def localize(
    bag: Bag,
    out: Out,
    topics: Mapping[str, str],
    source: Source = None,
    rectify: Rectify = None,
    motion: Annotated[
        Optional[str], typer.Option(help="auto, odometry, or none for the images alone")
    ] = None,
    target: Annotated[Optional[str], typer.Option(help="kind of the target, none or tags")] = None,
    robot: Urdf = "",
    setting: Setting = None,
    settings: Annotated[
        bool,
        typer.Option(
            "--settings", callback=lists_settings(LocalizeOptions), is_eager=True, help="list them"
        ),
    ] = False,
) -> None:
    """Follow the camera through a bag: TUM trajectory, 6x6 covariances, picture, summary.json."""
    del settings  # the callback has answered it
    shortcuts = {
        "input.source": source,
        "input.rectify": rectify,
        "input.motion": motion,
        "target.kind": target,
    }
    given = given_settings(shortcuts, setting)
    options = with_settings(LocalizeOptions(topics=topics, robot=robot), given)
    _localize(bag, out, options)


def _localize(bag: Path, out: Path, options: LocalizeOptions) -> None:
    from infomap_ros.replay.localizing.localize_files import write_localize_files

    with BagReader(bag) as reader:
        run = LocalizeRun(reader, options)
        run_with_bar(run.run, "locating", "views", run.inputs.frames)
        summary = write_localize_files(run, out)
        for text in [*reader.problems, *_remarks(run)]:
            typer.echo(f"infomap: {text}", err=True)
    typer.echo(json.dumps(summary))


def _remarks(run: LocalizeRun) -> list[str]:
    """What the user should know beside the figures."""
    texts = [f"{n} images dropped: {why}" for why, n in run.inputs.perception.dropped.items()]
    texts += [f"{n} records refused: {why}" for why, n in run.refused.items()]
    texts += [f"{n} views without odometry: {why}" for why, n in run.without_motion.items()]
    results = run.log.localisations
    lost = [one for one in results if one.T_map_camera is None]
    if lost:
        first = 1e-9 * (lost[0].stamp - results[0].stamp)
        texts.append(
            f"{len(lost)} of {len(results)} views could not be located, the first after "
            f"{first:.2f} s: {lost[0].reason}"
        )
    return texts
