"""``infomap study planar`` and ``infomap study two``."""

import time
from collections.abc import Sequence
from dataclasses import replace
from itertools import combinations
from pathlib import Path
from typing import Annotated, Optional

import numpy as np
import typer

from infomap_ros.cli.study_options import (
    DrawOnly,
    Jobs,
    Out,
    Quick,
    Strategies,
    chosen_strategies,
    finish,
    progress_bar,
    refusals,
    workers,
)
from infomap_ros.errors import InvalidInputError
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.studies.figure_style import Band, band, ratio_band
from infomap_ros.studies.planar import report
from infomap_ros.studies.planar.planar_study import (
    BASELINES,
    PlanarStudyConfig,
    TeamStudyConfig,
    complete,
    quick,
    tasks_of,
    team_tasks,
)
from infomap_ros.studies.planar.tasks import Record, distance_to, label_of, run_tasks
from infomap_ros.studies.runs import markdown, write_rows

# How the baselines stand to each other: distances to growing shares of a world, paired by world.
#
# Their authors publish seconds of rotorcraft in buildings, which a sensor in a plane does not have;
# what they say of each other can be compared.

_SHARES = (0.25, 0.5, 0.75)  # of a world, before the last
_LEAST_WORLDS = 3  # that a band is told for


def relations(records: Sequence[Record], share: float) -> str:
    """Distances of each baseline over those of each other one, as a Markdown table.

    Args:
        records: of worlds that all strategies have explored.
        share: of a world to which distances are compared last.

    Returns:
        Geometric means over the worlds in which both came so far; "" where there are no baselines.
    """
    present = {record.task.label for record in records}
    labels = [label for label in map(label_of, BASELINES) if label in present]
    kinds = ("all", *dict.fromkeys(record.task.world.kind for record in records))
    shares = (*_SHARES, share)
    names = ["distance of", "over that of", "worlds", *(f"to {100 * s:g} %" for s in shares)]
    lines = [
        [other, first, kind, *(_text(length_ratio(records, other, first, s, kind)) for s in shares)]
        for first, other in combinations(labels, 2)
        for kind in kinds
    ]
    note = "Geometric mean and band over the worlds, whose number follows, where both came so far."
    return f"{markdown(names, lines)}\n{note}\n" if lines else ""


def length_ratio(
    records: Sequence[Record], own: str, other: str, share: float, kind: str = "all"
) -> Band:
    """Distance of one strategy to a share of the world over that of another.

    Args:
        records: of both, in the same order of worlds.
        own: label.
        other: label.
        share: of a world.
        kind: of worlds, or "all".

    Returns:
        The geometric mean over the worlds in which both came so far, and not by the first view.
    """
    mine, theirs = (_distances(records, label, share, kind) for label in (own, other))
    both = np.isfinite(mine) & np.isfinite(theirs) & (mine > 0.0) & (theirs > 0.0)
    return ratio_band(mine[both], theirs[both]) if both.any() else band(np.empty(0))


def _distances(records: Sequence[Record], label: str, share: float, kind: str) -> FloatArray:
    results = [
        record.result
        for record in records
        if record.task.label == label and kind in ("all", record.task.world.kind)
    ]
    return np.array([distance_to(r.distance, r.fraction, share) for r in results])


def _text(found: Band) -> str:
    text = found.text(1.0, 2) if found.count >= _LEAST_WORLDS else f"{found.mean:.2f}"
    return f"{text} ({found.count})"


FloorPlans = Annotated[
    Optional[Path], typer.Option(help="folder with ROS maps (.yaml) to explore besides")
]


def planar(
    out: Out,
    worlds: Annotated[
        int, typer.Option(help="drawn at random, besides that of Fig. 10", min=0)
    ] = PlanarStudyConfig.worlds,
    seed: Annotated[int, typer.Option(help="of the first world")] = PlanarStudyConfig.seed,
    strategies: Strategies = "",
    scans: Annotated[int, typer.Option(help="of the figures")] = PlanarStudyConfig.scans,
    cell: Annotated[float, typer.Option(help="edge of a cell [m]")] = PlanarStudyConfig.cell,
    floor_plans: FloorPlans = None,
    jobs: Jobs = 0,
    is_quick: Quick = False,
    draw_only: DrawOnly = False,
) -> None:
    """Figs. 10, 11, 13, 14: one sensor in planar worlds, many strategies.

    What is done is kept in OUT/runs, and not done again when the command is repeated.
    """
    with refusals():
        config = replace(PlanarStudyConfig(), worlds=worlds, seed=seed, scans=scans, cell=cell)
        config = quick(config) if is_quick else config
        config = replace(config, strategies=chosen_strategies(strategies, config.strategies))
        tasks = tasks_of(config, _plans_in(floor_plans))
        start = time.monotonic()
        with progress_bar("explorations", len(tasks)) as advance:
            records = run_tasks(tasks, out / "runs", workers(jobs), advance, compute=not draw_only)
    rows = report.rows_of(records, config)
    write_rows(rows, out / "planar.csv")
    report.write_curves(records, out / "planar_curves.csv")
    if len(records) < len(tasks):
        records = complete(records)
        rows = report.rows_of(records, config)
    report.draw_figures(records, config, out)
    tables = [report.overview(rows, config), report.comparisons(rows, config)]
    tables.append(relations(records, config.share))
    finish("planar", "\n".join(tables), report.summary(rows, time.monotonic() - start), out)


def two(
    out: Out,
    worlds: Annotated[
        int, typer.Option(help="drawn at random, besides that of Fig. 10", min=0)
    ] = TeamStudyConfig.worlds,
    seed: Annotated[int, typer.Option(help="of the first world")] = TeamStudyConfig.seed,
    strategies: Strategies = "",
    sensors: Annotated[int, typer.Option(help="that explore together")] = TeamStudyConfig.sensors,
    scans: Annotated[int, typer.Option(help="of all together")] = TeamStudyConfig.scans,
    jobs: Jobs = 0,
    is_quick: Quick = False,
    draw_only: DrawOnly = False,
) -> None:
    """Fig. 12: two sensors that share their map by the messages of a team, and keep apart.

    What is done is kept in OUT/runs, and not done again when the command is repeated.
    """
    with refusals():
        config = TeamStudyConfig(worlds=worlds, seed=seed, sensors=sensors, scans=scans)
        if is_quick:
            quickly = ("random", "largest_information")
            config = replace(config, worlds=0, scans=12, candidates=120, strategies=quickly)
        config = replace(config, strategies=chosen_strategies(strategies, config.strategies))
        tasks, start = team_tasks(config), time.monotonic()
        with progress_bar("explorations", len(tasks)) as advance:
            records = run_tasks(tasks, out / "runs", workers(jobs), advance, compute=not draw_only)
    report.write_curves(records, out / "two_curves.csv")
    report.draw_team_figures(records, config.scans, out)
    table = report.team_overview(records, config.scans)
    figures: dict[str, float | str] = {"seconds": round(time.monotonic() - start, 1)}
    for name in config.strategies:
        label = label_of(name)
        own = [record.result for record in records if record.task.label == label]
        if own:
            figures[f"{label}.fraction"] = round(float(np.mean([r.fraction[-1] for r in own])), 4)
            figures[f"{label}.distance"] = round(float(np.mean([r.distance[-1] for r in own])), 1)
    finish("two", table, figures, out)


def _plans_in(folder: Path | None) -> Sequence[Path]:
    """The floor plans of a folder.

    Raises:
        InvalidInputError: there are none.
    """
    if folder is None:
        return ()
    found = sorted(folder.glob("*.yaml"))
    if not found:
        raise InvalidInputError("floor plans", f"no .yaml file in {folder}")
    return found
