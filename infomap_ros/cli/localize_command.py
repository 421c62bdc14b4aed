"""Command ``infomap localize``, and what it leaves behind."""

import json
from collections.abc import Iterable, Mapping
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

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
from infomap_ros.geometry import quaternion_from_transform
from infomap_ros.geometry.atomic_file import save_figure, write_text
from infomap_ros.replay.localize_run import LocalizeOptions, LocalizeRun, Progress, Trajectory
from infomap_ros.replay.mapped_bag import Recording, open_recording
from infomap_ros.viewer import LivePage
from infomap_ros.viewer.displays import ScanDisplay

TRAJECTORY_FILE, CORRECTED_FILE = "trajectory.txt", "corrected_trajectory.txt"
COVARIANCE_FILE, SUMMARY_FILE = "covariances.txt", "summary.json"

FILES = {
    "trajectory.png": "the path from above and from the side, and its uncertainty",
    CORRECTED_FILE: "poses after all that was learned later, as TUM has them (for evo)",
    TRAJECTORY_FILE: "poses as they were known at their stamps",
    COVARIANCE_FILE: "their 6x6 covariances",
    SUMMARY_FILE: "the figures of the run",
}
"""What `write_localize_files` leaves, what a person looks at first at the beginning."""

_STATES = {"tracking": "tab:green", "coasting": "tab:orange", "lost": "tab:red", "searching": "0.5"}


def write_localize_files(run: LocalizeRun, out: Path) -> dict[str, int | float | str]:
    """Write trajectories, covariances, a picture and the summary.

    Args:
        run: a finished run.
        out: folder; made if it is not there.

    Returns:
        The summary.

    Raises:
        OSError: something cannot be written.
    """
    out.mkdir(parents=True, exist_ok=True)
    trajectory = run.log.trajectory
    write_tum(trajectory, out / TRAJECTORY_FILE)
    write_tum(run.log.corrected_trajectory, out / CORRECTED_FILE)
    write_covariances(trajectory, out / COVARIANCE_FILE)
    draw_run(run, out / "trajectory.png")
    summary = run.summary()
    write_text(out / SUMMARY_FILE, json.dumps(summary, indent=1) + "\n")
    return summary


def write_tum(trajectory: Trajectory, path: Path) -> None:
    """Write ``stamp x y z qx qy qz qw`` for each pose [s, m], as the TUM benchmark has it."""
    poses = ([*pose[:3, 3], *quaternion_from_transform(pose)] for pose in trajectory.transforms)
    _write("stamp [s] x y z [m] qx qy qz qw: T_map_camera", trajectory.stamps, poses, path)


def write_covariances(trajectory: Trajectory, path: Path) -> None:
    """Write the stamp and the 36 numbers of the covariance of each pose, row by row."""
    title = "stamp [s] 6x6 covariance in the map: x y z [m], rotation about them [rad]"
    _write(title, trajectory.stamps, trajectory.covariances.reshape(-1, 36), path)


def _write(
    title: str, stamps: Iterable[np.int64], rows: Iterable[Iterable[float]], path: Path
) -> None:
    """Write a line for each stamp [ns], which becomes seconds with all digits kept."""
    lines = [f"# {title}\n"]
    for stamp, row in zip(stamps, rows, strict=True):
        whole, rest = divmod(int(stamp), 1_000_000_000)
        lines.append(f"{whole}.{rest:09d} " + " ".join(f"{n:.9g}" for n in row) + "\n")
    write_text(path, "".join(lines))


def draw_run(run: LocalizeRun, path: Path) -> None:
    """Draw the path from above and from the side, and how certain it is over time.

    Raises:
        OSError: the file cannot be written.
    """
    figure = Figure(figsize=(11.0, 7.0), layout="constrained")
    grid = figure.add_gridspec(2, 2, height_ratios=(2.0, 1.0))
    then, now = run.log.trajectory, run.log.corrected_trajectory
    for column, (first, second, title) in enumerate(((0, 1, "top view"), (0, 2, "side view"))):
        axes = figure.add_subplot(grid[0, column])
        _draw_path(axes, then, now, (first, second))
        axes.set_title(title)
    _draw_certainty(figure.add_subplot(grid[1, :]), run, then)
    save_figure(figure, path, 100)


def _draw_path(axes: Axes, then: Trajectory, now: Trajectory, which: tuple[int, int]) -> None:
    for trajectory, style, label in ((then, "-", "online"), (now, "--", "after corrections")):
        places = trajectory.transforms[:, :3, 3]
        axes.plot(places[:, which[0]], places[:, which[1]], style, label=label, linewidth=1.2)
    axes.set_xlabel(f"{'xyz'[which[0]]} [m]")
    axes.set_ylabel(f"{'xyz'[which[1]]} [m]")
    axes.set_aspect("equal", adjustable="datalim")
    axes.locator_params(nbins=6)  # numbers of a path of centimeters are long
    axes.grid(visible=True, alpha=0.3)
    axes.legend(loc="best", fontsize="small")


def _draw_certainty(axes: Axes, run: LocalizeRun, trajectory: Trajectory) -> None:
    start = run.log.localizations[0].stamp
    times = _times(trajectory.stamps, start)
    spread: NDArray[Any] = np.trace(trajectory.covariances[:, :3, :3], axis1=1, axis2=2)
    axes.plot(times, 1e3 * np.sqrt(spread), color="tab:blue")
    axes.set_xlabel("time [s]")
    axes.set_ylabel("position sigma [mm]")
    for state, color in _STATES.items():
        stamps = np.array([o.stamp for o in run.log.localizations if o.state == state], np.int64)
        if len(stamps):
            label = "dead reckoning" if state == "coasting" else state
            axes.plot(_times(stamps, start), np.zeros(len(stamps)), "|", color=color, label=label)
    axes.grid(visible=True, alpha=0.3)
    axes.legend(loc="upper left", fontsize="small")


def _times(stamps: NDArray[np.int64], start: int) -> NDArray[np.float64]:
    return np.asarray(1e-9 * (stamps - start), np.float64)


_DEFAULTS = LocalizeOptions()


@takes_topics(*IMAGE_TOPICS, "color", "odometry", "imu", "joints")
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
    motion = run.inputs.odometry_topic or run.inputs.imu_topic or "the images alone"
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
