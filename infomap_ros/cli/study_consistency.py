"""The studies of localization and of consistency on the command line."""

import time
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from matplotlib.figure import Figure
from scipy import stats

from infomap_ros.cli.study_options import (
    DrawOnly,
    Jobs,
    Out,
    finish,
    progress_bar,
    refusals,
    workers,
)
from infomap_ros.geometry.atomic_file import save_figure, write_text
from infomap_ros.studies.drift import (
    DriftConfig,
    WalkErrors,
    drift_rows,
    drift_summary,
    drift_table,
    panels_of,
    tasks_of,
)
from infomap_ros.studies.map_consistency import (
    CONFIDENCE,
    ConsistencyConfig,
    ConsistencyResult,
    run_study,
    summary,
    table,
)
from infomap_ros.studies.pose_consistency import (
    SCENARIOS,
    PoseConsistencyConfig,
    pose_summary,
    pose_table,
    run_pose_consistency,
)
from infomap_ros.studies.runs import Kept, run_all

_LIMIT = 4.0  # of the drawn normalized errors
_BINS = 48
_COLUMNS = 4
_ALL, _INDEPENDENT, _EXPECTED = "#9ecae1", "#08519c", "#d55e00"


def draw_histograms(results: Sequence[ConsistencyResult], path: str | Path) -> None:
    """Draw the normalized errors of each setting with the normal distribution they should have.

    Args:
        results: of `run_study`.
        path: of the PNG file.
    """
    columns = min(len(results), _COLUMNS)
    rows = -(-len(results) // columns)
    figure = Figure(figsize=(4.0 * columns, 3.6 * rows), layout="constrained")
    axes = figure.subplots(rows, columns, sharey=True, squeeze=False).ravel()
    for axis in axes[len(results) :]:
        axis.set_axis_off()
    x = np.linspace(-_LIMIT, _LIMIT, 200)
    edges = np.linspace(-_LIMIT, _LIMIT, _BINS + 1)
    coarse = edges[::4]
    for axis, result in zip(axes, results, strict=False):
        clipped = np.clip(result.all_errors, -_LIMIT, _LIMIT)
        axis.hist(clipped, edges, density=True, color=_ALL, label="all voxels looked at")
        independent = np.clip(result.independent, -_LIMIT, _LIMIT)
        axis.hist(
            independent, coarse, density=True, histtype="step", color=_INDEPENDENT, linewidth=1.4,
            label="one voxel per scene",
        )  # fmt: skip
        axis.plot(x, stats.norm.pdf(x), color=_EXPECTED, linewidth=1.6, label="standard normal")
        low, high = result.band
        setting = result.setting
        kind = " within the map" if setting.relative else ""
        pixels = ", correlated pixels" if setting.correlation else ""
        axis.set_title(
            f"{setting.case}{kind}, {100 * setting.voxel_size:g} cm{pixels}\n"
            f"mean NEES {result.mean_nees:.2f}, "
            f"{100 * CONFIDENCE:.0f} % band {low:.2f} to {high:.2f}",
            fontsize=10,
        )
        axis.set_xlabel("error along the normal / predicted sigma [-]")
        axis.set_xlim(-_LIMIT, _LIMIT)
    axes[0].set_ylabel("density [-]")
    axes[0].set_ylim(0.0, 0.65)  # room for the legend
    axes[0].legend(fontsize=8, loc="upper left")
    save_figure(figure, path, 120)


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


_QUICK_RUNS = 8


def drift(
    out: Out,
    runs: Annotated[int, typer.Option(help="random walks per panel")] = DriftConfig.runs,
    seed: Annotated[int, typer.Option(help="of the first walk")] = DriftConfig.seed,
    jobs: Jobs = 0,
    is_quick: Annotated[
        bool, typer.Option("--quick", help=f"{_QUICK_RUNS} walks per panel only")
    ] = False,
    draw_only: DrawOnly = False,
) -> None:
    """How far the position drifts by scene fiducials alone (Fig. 15), by three methods.

    What is done is kept in OUT/runs, and not done again when the command is repeated. Exits with 1
    if the default's error at the last step is more than half of the printed method's in a panel.
    """
    from infomap_ros.studies.drift import draw_drift

    with refusals():
        config = DriftConfig(runs=_QUICK_RUNS if is_quick else runs, seed=seed)
        tasks, start = tasks_of(config), time.monotonic()
        kept = Kept(out / "runs", WalkErrors)
        with progress_bar("walks", len(tasks)) as advance:
            results = run_all(tasks, kept, workers(jobs), advance, compute=not draw_only)
    panels = panels_of(results)
    if panels:
        draw_drift(panels, [out / "drift.png", out / "drift.svg"])
    write_text(out / "drift.csv", "\n".join(drift_rows(panels)) + "\n")
    finish("drift", drift_table(panels), drift_summary(panels, time.monotonic() - start), out)
    raise typer.Exit(0 if all(panel.ratio <= 0.5 for panel in panels) else 1)


def pose_consistency(
    out: Out,
    runs: Annotated[
        int, typer.Option(help="random runs of each scenario")
    ] = PoseConsistencyConfig.runs,
    seed: Annotated[int, typer.Option(help="of the first run")] = PoseConsistencyConfig.seed,
) -> None:
    """Are the poses as sure as they should be? Their errors against their own covariances.

    Exits with 1 if a mean is outside its band, or a pose is wrong where half of all moves.
    """
    from infomap_ros.studies.pose_consistency import draw_nees

    start = time.monotonic()
    with refusals(), progress_bar("runs", runs * len(SCENARIOS)) as advance:
        results = run_pose_consistency(PoseConsistencyConfig(runs=runs, seed=seed), advance)
    out.mkdir(parents=True, exist_ok=True)
    draw_nees(results, out / "pose_consistency.png")
    figures = pose_summary(results, time.monotonic() - start)
    finish("pose_consistency", pose_table(results), figures, out)
    raise typer.Exit(0 if all(result.is_consistent for result in results) else 1)
