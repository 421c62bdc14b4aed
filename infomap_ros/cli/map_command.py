"""Command ``infomap map``."""

from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Annotated, Optional

import typer

from infomap_ros.cli.command_options import (
    IMAGE_TOPICS,
    Bags,
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
from infomap_ros.errors import BagError, CapacityError, InvalidInputError
from infomap_ros.replay.map_files import FILES, write_map_files
from infomap_ros.replay.map_inputs import MapOptions
from infomap_ros.replay.map_run import MapRun, Progress
from infomap_ros.replay.mapped_bag import Recording, open_recording
from infomap_ros.studies.survey import map_survey, parts_of
from infomap_ros.viewer import LivePage
from infomap_ros.viewer.displays import ScanDisplay

_DEFAULTS = MapOptions()
_USUAL = _DEFAULTS.map


@takes_topics(*IMAGE_TOPICS, "pose_topic", "joints")
def map_bag(
    bags: Bags,
    out: Out,
    topics: Mapping[str, str],
    calibration: Calibration = None,
    voxel_size: Annotated[
        Optional[float],
        typer.Option(help=f"edge of a voxel [m]; {_USUAL.voxel_size:g}, more in a large scene"),
    ] = None,
    max_range: Annotated[
        Optional[float],
        typer.Option(help=f"farthest point [m]; {_USUAL.max_range:g}, more in a large scene"),
    ] = None,
    source: Source = _DEFAULTS.input.source,
    rectify: Rectify = _DEFAULTS.input.rectify,
    poses: Annotated[
        str, typer.Option(help="where poses come from: auto, bag or localize")
    ] = _DEFAULTS.input.poses,
    map_frame: Annotated[Optional[str], typer.Option(help="frame of the map")] = None,
    pose_frame: Annotated[
        Optional[str], typer.Option(help="frame whose pose the pose topic gives")
    ] = None,
    robot: Urdf = "",
    setting: Setting = None,
    overwrite: Overwrite = False,
    live: Live = False,
    cluster: Annotated[
        str,
        typer.Option(
            help="address of a Dask scheduler that sees the bags by the same paths, or local for "
            "a worker on each core: bags with poses are cut into parts",
            metavar="ADDRESS",
        ),
    ] = "",
    settings: Annotated[bool, lists_settings(MapOptions)] = False,
) -> None:
    """Map a bag or a folder of images: map.html, map.png, map file, .ply and summary.json.

    Several bags in one frame become one map, the same to the bit with any number of workers.
    Ctrl-C ends the run early: what was mapped until then is written.
    """
    del settings  # the callback has answered it
    shortcuts: dict[str, tuple[str, object]] = {
        "--voxel-size": ("map.voxel_size", voxel_size),
        "--max-range": ("map.max_range", max_range),
        "--source": ("input.source", source),
        "--rectify": ("input.rectify", rectify),
        "--poses": ("input.poses", poses),
        "--map-frame": ("input.map_frame", map_frame),
        "--pose-frame": ("input.pose_frame", pose_frame),
    }
    least = ["input.fit_scene=false"] if (voxel_size, max_range) != (None, None) else []
    options = chosen(MapOptions(topics=topics, robot=robot), shortcuts, setting, least)
    is_survey = bool(cluster) or len(bags) > 1
    if live and is_survey:
        raise InvalidInputError("--live", "shows one bag that is mapped by this process alone")
    files = tuple(calibration or ())
    with (
        open_recording(bags[0], files) as recording,
        results_in(out, overwrite),
        live_page(live, f"Mapping {bags[0].name}") as page,
    ):
        run = MapRun(recording, options)
        work: Callable[[Progress], None]
        work, what, total = run.run, "frames", run.inputs.frames
        if is_survey:
            parts = parts_of(bags, files, run.options)
            work = partial(
                map_survey, run, recording, parts, cluster, partial(typer.echo, err=True)
            )
            what, total = "parts", sum(map(len, parts))
        elif page is not None:
            work = partial(_run_live, run, page)
        run_with_bar(work, run.stop, "mapping", what, total)
        _finish(run, recording, out)


def _finish(run: MapRun, recording: Recording, out: Path) -> None:
    """Write what was mapped, and say what came of it."""
    summary = write_map_files(run, out)
    for text in _remarks(run, recording):
        typer.echo(f"infomap: {text}", err=True)
    say_results(_sentences(run), summary, out, FILES)
    if run.full:
        raise CapacityError(f"the map is full, what came later is not in it: {run.full}")
    if run.stopped:
        raise typer.Exit(INTERRUPTED)
    if why := run.why_mostly_dropped():
        raise BagError(why)


def _run_live(run: MapRun, page: LivePage, progress: Progress) -> None:
    """Map, and show it on a page."""
    display = ScanDisplay(page, "frames")

    def show(done: int, total: int) -> None:
        progress(done, total)
        display.show(done, total, run.T_map_camera, run.map)

    run.run(show)
    display.finish(run.map, _sentences(run)[0])


def _sentences(run: MapRun) -> list[str]:
    """The run as a person is told it."""
    of = run.frames + sum(run.dropped.values())
    bounds, size = run.map.bounds(), run.map.config.voxel_size
    lines = [f"{run.frames} of {of} frames mapped in {run.seconds:.1f} s"]
    if run.stopped:
        lines[0] = f"interrupted after {of} of {run.inputs.frames} frames: {lines[0]}"
    lines.append(f"{run.map.surface_voxels:,} surface voxels of {length(size)}")
    if bounds is not None:
        low, high = bounds[0] * size, (bounds[1] + 1) * size
        ends = zip("xyz", low, high, strict=True)
        lines[-1] += ", " + ", ".join(f"{name} {a:.2f} to {b:.2f} m" for name, a, b in ends)
    where = run.inputs.pose_topic or "the images (no poses were recorded)"
    lines.append(f"poses from {where}, in frame {run.inputs.map_frame}")
    return lines


def _remarks(run: MapRun, recording: Recording) -> list[str]:
    """What the user should know beside the figures."""
    remarks = list(recording.problems)
    for what, counts in (
        ("message skipped", recording.skipped),
        ("frame dropped", run.dropped),
        ("pose refused", run.refused),
    ):
        for text, count in counts.items():
            noun, _, verb = what.partition(" ")
            remarks.append(f"{count} {noun}{'s' * (count != 1)} {verb}: {text}")
    if run.fitted:
        config = run.map.config
        remarks.append(
            f"most of the scene is beyond {_USUAL.max_range:g} m: it is mapped up to "
            f"{config.max_range:g} m with voxels of {length(config.voxel_size)} "
            "(--max-range, --voxel-size; --set input.fit_scene=false for the usual ones)"
        )
    elif run.points_beyond > run.points:
        remarks.append(
            f"most of the points are beyond {run.map.config.max_range:g} m and tell only what is "
            "free: give a larger --max-range, or neither that nor --voxel-size"
        )
    if run.builder.assumed_poses:
        assumed = run.assumed
        remarks.append(
            f"{run.inputs.pose_topic} has no covariance: poses are taken to be right to "
            f"{length(assumed.default_position_sigma)} and {assumed.default_rotation_sigma:g} rad "
            "(--set assumed.default_position_sigma=, assumed.default_rotation_sigma=)"
        )
    return remarks
