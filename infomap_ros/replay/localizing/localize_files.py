"""What localization of a bag leaves behind."""

from __future__ import annotations

import json
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from infomap_ros.geometry import quaternion_from_transform
from infomap_ros.geometry.atomic_file import save_figure, write_text
from infomap_ros.replay.localizing.localize_run import LocalizeRun, Trajectory

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
