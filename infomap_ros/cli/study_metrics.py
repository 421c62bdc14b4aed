"""``infomap study metrics``."""

import time
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from infomap_ros.cli.study_options import (
    DrawOnly,
    Jobs,
    Out,
    Quick,
    finish,
    progress_bar,
    refusals,
    workers,
)
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.mapping import VoxelMap
from infomap_ros.studies.metrics_study import (
    MetricRun,
    MetricsStudyConfig,
    Results,
    comparisons,
    complete,
    overview,
    rows_of,
    summary,
    tasks_of,
)
from infomap_ros.studies.planar.world import PlanarWorld, SensorConfig, level_pose, take_scan
from infomap_ros.studies.published_metrics import EVERY_METRIC
from infomap_ros.studies.runs import Kept, run_all, write_lines, write_rows
from infomap_ros.views.information.view_information import Metric, expected_information
from infomap_ros.views.information.view_query import InformationConfig

# What the metrics say of a view that is wholly unknown, partly known, or wholly known.
#
# A planar sensor stands in an empty world. All that lies nearer than some distance is mapped as
# free; the rest of the view is unknown. A metric that tells what is new is 0 where nothing is
# unknown and grows with the unknown.

_SIDE = 44  # of the empty world [m]
_MIDDLE = 0.5 * _SIDE + 0.5  # the middle of a cell


def unknown_shares(levels: int = 41) -> FloatArray:
    """Shares of the view that are unknown, from 0 to 1, shape (levels,)."""
    return np.linspace(0.0, 1.0, levels)


def values_by_share(
    shares: FloatArray, sensor: SensorConfig | None = None
) -> dict[str, FloatArray]:
    """What each metric says of a view of which these shares are unknown.

    Args:
        shares: in [0, 1], shape (N,).
        sensor: of the view; that of the planar studies by default.

    Returns:
        Values by metric, shape (N,) each, in the metric's unit.
    """
    settings = sensor or SensorConfig()
    pose = level_pose(np.full(2, _MIDDLE), 0.0, 1.0)
    config = InformationConfig(min_range=0.0, range_noise=0.0, pixel_angle=1e-4, planar=True)
    region = np.array([[0.0, 0.0, 0.0], [_SIDE, _SIDE, 1.0]])
    maps = [_mapped_up_to(settings, settings.max_range * float(np.sqrt(1.0 - s))) for s in shares]

    def value(metric: Metric, known: VoxelMap) -> float:
        view = settings.camera, settings.max_range
        return float(expected_information(known, pose[None], *view, metric, config, region)[0])

    return {
        name: np.array([value(metric, known) for known in maps])
        for name, metric in EVERY_METRIC.items()
    }


def _mapped_up_to(sensor: SensorConfig, distance: float) -> VoxelMap:
    """A map in which all of the view that is nearer than a distance [m] is free."""
    if distance <= 0.0:
        return VoxelMap(sensor.map_config(1.0))
    near, world = replace(sensor, max_range=max(distance, 0.1)), _empty()
    voxel_map = VoxelMap(near.map_config(1.0))
    take_scan(world.truth, near, level_pose(world.start, 0.0, 1.0), voxel_map)
    return voxel_map


def _empty() -> PlanarWorld:
    """A square without obstacles; the sensor stands in its middle."""
    occupied = np.pad(np.zeros((_SIDE - 2, _SIDE - 2), np.bool_), 1, constant_values=True)
    return PlanarWorld("empty", "empty", occupied, 1.0, np.full(2, _MIDDLE))


def metrics(
    out: Out,
    worlds: Annotated[int, typer.Option(help="of each kind")] = MetricsStudyConfig.worlds,
    seed: Annotated[int, typer.Option(help="of the first world")] = MetricsStudyConfig.seed,
    names: Annotated[str, typer.Option("--metrics", help="names, with commas; all if empty")] = "",
    jobs: Jobs = 0,
    is_quick: Quick = False,
    draw_only: DrawOnly = False,
) -> None:
    """Every information metric in the same loop and worlds, with the same strategy.

    What is done is kept in OUT/runs, and not done again when the command is repeated.
    """
    from infomap_ros.studies.metrics_study import draw_curves, draw_unknown

    with refusals():
        config = MetricsStudyConfig(worlds=worlds, seed=seed)
        if is_quick:
            kinds = config.kinds[:1]
            config = replace(config, worlds=1, kinds=kinds, scans=8, candidates=60)
        if names:
            config = replace(config, metrics=tuple(names.split(",")))
        tasks, start = tasks_of(config), time.monotonic()
        kept = Kept(out / "runs", MetricRun)
        with progress_bar("explorations", len(tasks)) as advance:
            results = run_all(tasks, kept, workers(jobs), advance, compute=not draw_only)
    write_rows(rows_of(results, config), out / "metrics.csv")
    _write_curves(results, out / "metrics_curves.csv")
    results = complete(results)
    rows = rows_of(results, config)
    draw_curves(results, config, out / "metrics_curves")
    shares = unknown_shares()
    values = values_by_share(shares)
    lines = [[float(v) for v in row] for row in zip(shares, *values.values(), strict=True)]
    write_lines(["unknown_share", *values], lines, out / "metrics_unknown.csv")
    draw_unknown(shares, values, out / "metrics_unknown")
    tables = overview(rows, config) + "\n" + comparisons(rows, config)
    finish("metrics", tables, summary(rows, time.monotonic() - start), out)


def _write_curves(results: Results, path: Path) -> None:
    """Figures after each scan, one line each."""
    columns = ("fraction", "distance", "bits", "wrong", "seconds")
    lines = [
        [str(task.world), task.metric, scan, *map(float, values)]
        for task, run in results.items()
        for scan, values in enumerate(
            zip(*(getattr(run, name) for name in columns), strict=True), 1
        )
    ]
    names = ["world", "metric", "scan", "fraction", "distance_m", "bits", "wrong", "processor_s"]
    write_lines(names, lines, path)
