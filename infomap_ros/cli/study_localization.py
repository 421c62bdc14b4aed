"""The studies of localization on the command line."""

import time
from typing import Annotated

import typer

from infomap_ros.cli.study_options import (
    DrawOnly,
    Jobs,
    Out,
    finish,
    progress_bar,
    refusals,
    workers,
)
from infomap_ros.geometry.atomic_file import write_text
from infomap_ros.studies.common.runs import Kept, run_all
from infomap_ros.studies.drift import (
    DriftConfig,
    WalkErrors,
    drift_rows,
    drift_summary,
    drift_table,
    panels_of,
    tasks_of,
)
from infomap_ros.studies.pose_consistency import (
    SCENARIOS,
    PoseConsistencyConfig,
    pose_summary,
    pose_table,
    run_pose_consistency,
)

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
