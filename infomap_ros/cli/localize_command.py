"""Command ``infomap localize``."""

from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Annotated

import typer

from infomap_ros.cli.command_options import (
    IMAGE_TOPICS,
    Bag,
    Calibration,
    Out,
    Overwrite,
    Rectify,
    Setting,
    Source,
    Urdf,
    chosen,
    lists_settings,
    takes_topics,
)
from infomap_ros.cli.results import (
    INTERRUPTED,
    Live,
    length,
    live_page,
    results_in,
    run_with_bar,
    say_results,
)
from infomap_ros.errors import BagError
from infomap_ros.replay.localizing.localize_files import FILES, write_localize_files
from infomap_ros.replay.localizing.localize_run import LocalizeOptions, LocalizeRun, Progress
from infomap_ros.replay.mapped_bag import Recording, open_recording
from infomap_ros.viewer import LivePage
from infomap_ros.viewer.scan_display import ScanDisplay

_DEFAULTS = LocalizeOptions()


@takes_topics(*IMAGE_TOPICS, "color", "odometry", "joints")
def localize(
    bag: Bag,
    out: Out,
    topics: Mapping[str, str],
    calibration: Calibration = None,
    source: Source = _DEFAULTS.input.source,
    rectify: Rectify = _DEFAULTS.input.rectify,
    motion: Annotated[
        str, typer.Option(help="auto, odometry, or none for the images alone")
    ] = _DEFAULTS.input.motion,
    target: Annotated[
        str, typer.Option(help="kind of the target: none, tags or model (a mesh)")
    ] = _DEFAULTS.target.kind,
    robot: Urdf = "",
    setting: Setting = None,
    overwrite: Overwrite = False,
    live: Live = False,
    settings: Annotated[bool, lists_settings(LocalizeOptions)] = False,
) -> None:
    """Estimate the camera's trajectory: TUM file, 6x6 covariances, picture, summary.json.

    Ctrl-C ends the run early: the trajectory until then is written.
    """
    del settings  # the callback has answered it
    shortcuts: dict[str, tuple[str, object]] = {
        "--source": ("input.source", source),
        "--rectify": ("input.rectify", rectify),
        "--motion": ("input.motion", motion),
        "--target": ("target.kind", target),
    }
    options = chosen(LocalizeOptions(topics=topics, robot=robot), shortcuts, setting)
    with (
        open_recording(bag, calibration or ()) as recording,
        results_in(out, overwrite),
        live_page(live, f"Locating {bag.name}") as page,
    ):
        _localize(recording, out, options, page)


def _localize(
    recording: Recording, out: Path, options: LocalizeOptions, page: LivePage | None
) -> None:
    run = LocalizeRun(recording, options)
    work = run.run if page is None else partial(_run_live, run, page)
    run_with_bar(work, run.stop, "locating", "views", run.inputs.frames)
    summary = write_localize_files(run, out)
    for text in [*recording.problems, *_remarks(run)]:
        typer.echo(f"infomap: {text}", err=True)
    say_results(_sentences(run, summary), summary, out, FILES)
    if run.stopped:
        raise typer.Exit(INTERRUPTED)
    poses, views = int(summary["poses"]), int(summary["views"])
    if 2 * poses < views:
        raise BagError(f"{views - poses} of {views} views could not be located")


def _run_live(run: LocalizeRun, page: LivePage, progress: Progress) -> None:
    """Follow the camera, and show its path on a page."""
    display = ScanDisplay(page, "views")

    def show(done: int, total: int) -> None:
        progress(done, total)
        display.show(done, total, run.log.localizations[-1].T_map_camera)

    run.run(show)
    display.finish(None, f"{len(run.log.trajectory)} views located")


def _sentences(run: LocalizeRun, summary: Mapping[str, int | float | str]) -> list[str]:
    """The run as a person is told it."""
    motion = run.inputs.odometry_topic or "the images alone"
    early = "interrupted: " if run.stopped else ""
    return [
        f"{early}{summary['poses']} of {summary['views']} views located in {run.seconds:.1f} s, "
        f"by {motion}",
        f"path of {length(float(summary['path_length']))}, position sigma at its end "
        f"{length(float(summary['final_position_sigma']))}",
    ]


def _remarks(run: LocalizeRun) -> list[str]:
    """What the user should know beside the figures."""
    texts = [f"{n} images dropped: {why}" for why, n in run.inputs.perception.dropped.items()]
    texts += [f"{n} records refused: {why}" for why, n in run.refused.items()]
    texts += [f"{n} views without odometry: {why}" for why, n in run.without_motion.items()]
    results = run.log.localizations
    lost = [one for one in results if one.T_map_camera is None]
    if lost:
        first = 1e-9 * (lost[0].stamp - results[0].stamp)
        texts.append(
            f"{len(lost)} of {len(results)} views could not be located, the first after "
            f"{first:.2f} s: {lost[0].reason}"
        )
    return texts
