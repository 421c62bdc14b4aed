"""The metrics compared: what is run, and what it says.

infomap study metrics --out DIR

One exploration of a planar world whose views are chosen by one metric.

The figures of the comparison of metrics.
"""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from infomap_ros.geometry.config import parameter
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.mapping import VoxelMap
from infomap_ros.studies.figure_style import Band, band, band_note, draw_band, save, style_of
from infomap_ros.studies.planar.explore import ExplorationConfig, explore, planar_choice
from infomap_ros.studies.planar.tasks import (
    OneSensorConfig,
    WorldName,
    area_under_coverage,
    fraction_at,
)
from infomap_ros.studies.planar.world import PlanarWorld, SensorConfig, level_pose, take_scan
from infomap_ros.studies.published_metrics import EVERY_METRIC
from infomap_ros.studies.runs import in_all_worlds, markdown
from infomap_ros.views.information.gains import entropy_of

STRATEGY = "largest_information"
"""By which all metrics are compared: it ranks by the rating of eq. (11) alone."""


@dataclass(frozen=True, eq=False)
class MetricRun:
    """What became of an exploration; entry k is that after scan k, shape (K,) each.

    Attributes:
        fraction: share of the mappable cells that are mapped, in [0, 1].
        distance: moved until then [m].
        seconds: that the choice of the view took, time of the processor [s].
        bits: by which the entropy of the mappable cells has fallen [bits].
        wrong: share of the mapped cells that are on the wrong side of p = 1/2, in [0, 1].
        views: place [m] and azimuth [rad] of each scan, shape (K, 3).
        ended: why it ended.
    """

    fraction: FloatArray
    distance: FloatArray
    seconds: FloatArray
    bits: FloatArray
    wrong: FloatArray
    views: FloatArray
    ended: str


@dataclass(frozen=True)
class MetricTask:
    """One exploration: implements `infomap_ros.studies.runs.Task`.

    Attributes:
        world: to be explored.
        metric: name of one of `EVERY_METRIC`.
        config: sensor, number of scans, seed.
        candidates: number of candidate views.
    """

    world: WorldName
    metric: str
    config: ExplorationConfig
    candidates: int

    @property
    def file_name(self) -> str:
        """Where the result is kept."""
        return f"{self.world}__{self.metric}.npz"

    def fingerprint(self) -> str:
        """All that the result depends on, but for the code."""
        return json.dumps(dataclasses.asdict(self), sort_keys=True)

    def run(self) -> MetricRun:
        """Explore, then measure what the same scans have informed."""
        world, sensor = self.world.make(), self.config.sensor
        choice = planar_choice(sensor.max_range, world.cell, self.candidates, STRATEGY)
        metric = EVERY_METRIC.get(self.metric, self.metric)
        found = explore(world, STRATEGY, self.config, choice, metric=metric)
        bits, wrong = result_of_scans(world, sensor, found.views)
        return MetricRun(
            found.fraction, found.distance, found.seconds, bits, wrong, found.views, found.ended
        )


def result_of_scans(
    world: PlanarWorld, sensor: SensorConfig, views: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Bits removed and share of wrong cells after each scan, shape (K,) each; see `MetricRun`.

    Args:
        world: that is measured.
        sensor: that measures.
        views: place [m] and azimuth [rad] of each scan, shape (K, 3).
    """
    voxel_map = VoxelMap(sensor.map_config(world.cell))
    cells = np.argwhere(world.mappable)
    places = np.column_stack([cells + 0.5, np.full(len(cells), 0.5)]) * world.cell
    is_solid = world.occupied[world.mappable]
    rows = []
    for x, y, azimuth in views:
        take_scan(world.truth, sensor, level_pose(np.array([x, y]), azimuth, world.cell), voxel_map)
        p, known = voxel_map.probability(places), voxel_map.is_known(places)
        left = np.where(known, entropy_of(p), 1.0)
        wrong = (p[known] > 0.5) != is_solid[known]
        rows.append((len(left) - float(left.sum()), float(wrong.mean()) if len(wrong) else 0.0))
    bits, shares = np.array(rows).T
    return bits, shares


OWN = "expected_entropy_reduction"

Results = Mapping[MetricTask, MetricRun]


@dataclass(frozen=True)
class MetricsStudyConfig(OneSensorConfig):
    """Size of the study.

    Raises:
        ConfigError: a value is out of its range.
    """

    worlds: int = parameter(5, "Drawn worlds of each kind.", low=1, high=1000)
    metrics: tuple[str, ...] = parameter(tuple(EVERY_METRIC), "Names of metrics.")


def tasks_of(config: MetricsStudyConfig) -> list[MetricTask]:
    """All explorations, world by world and of each kind in turn."""
    return [
        _task(world, metric, config) for world in worlds_of(config) for metric in config.metrics
    ]


def worlds_of(config: MetricsStudyConfig) -> list[WorldName]:
    """All worlds, of each kind in turn."""
    return [world for number in range(config.worlds) for world in config.drawn(number)]


def _task(world: WorldName, metric: str, config: MetricsStudyConfig) -> MetricTask:
    exploration = ExplorationConfig(scans=config.scans, seed=world.seed, sensor=config.sensor)
    return MetricTask(world, metric, exploration, config.candidates)


def complete(results: Results) -> dict[MetricTask, MetricRun]:
    """What was explored by all metrics, for paired tables."""
    tasks = in_all_worlds(list(results), lambda t: str(t.world), lambda t: t.metric)
    return {task: results[task] for task in tasks}


@dataclass(frozen=True)
class Row:
    """Figures of one exploration.

    Attributes:
        world: its name.
        kind: of the world.
        metric: by which views were chosen.
        scans: taken.
        fraction: mapped at the end.
        area_scans: mean fraction mapped over the scans of the study.
        area_path: mean fraction mapped over the first `reach` meters.
        distance: moved until the end [m].
        bits: by which the entropy of the mappable cells has fallen at the end [1000 bits].
        wrong: share of the mapped cells that are on the wrong side of p = 1/2 at the end.
        seconds: of the choice of a view, mean time of the processor [s].
        ended: why.
    """

    world: str
    kind: str
    metric: str
    scans: int
    fraction: float
    area_scans: float
    area_path: float
    distance: float
    bits: float
    wrong: float
    seconds: float
    ended: str


def rows_of(results: Results, config: MetricsStudyConfig) -> list[Row]:
    """One row per exploration."""
    return [_row(task, run, config) for task, run in results.items()]


def _row(task: MetricTask, run: MetricRun, config: MetricsStudyConfig) -> Row:
    return Row(
        str(task.world),
        task.world.kind,
        task.metric,
        len(run.fraction),
        float(run.fraction[-1]),
        float(curve(run.fraction, config.scans).mean()),
        area_under_coverage(run.distance, run.fraction, config.reach),
        float(run.distance[-1]),
        1e-3 * float(run.bits[-1]),
        float(run.wrong[-1]),
        float(run.seconds[1:].mean()) if len(run.seconds) > 1 else 0.0,
        run.ended,
    )


def curve(values: FloatArray, scans: int) -> FloatArray:
    """Values after each of so many scans, shape (scans,); what was reached at the end stays."""
    return np.asarray(values[np.minimum(np.arange(scans), len(values) - 1)])


def metrics_in(rows: list[Row]) -> list[str]:
    """Metrics in order of appearance."""
    return list(dict.fromkeys(row.metric for row in rows))


def values_of(rows: list[Row], metric: str, name: str) -> FloatArray:
    """One figure of a metric in all worlds, shape (n,)."""
    return np.array([float(getattr(row, name)) for row in rows if row.metric == metric])


def difference(rows: list[Row], metric: str, name: str, kind: str = "all") -> Band:
    """A figure of a metric less that of `OWN`, paired over the worlds that both have explored."""
    by_world: dict[str, dict[str, float]] = {}
    for row in rows:
        if kind in ("all", row.kind):
            by_world.setdefault(row.world, {})[row.metric] = float(getattr(row, name))
    pairs = [found for found in by_world.values() if metric in found and OWN in found]
    return band(np.array([found[metric] - found[OWN] for found in pairs]))


def overview(rows: list[Row], config: MetricsStudyConfig) -> str:
    """Means by metric as a Markdown table."""
    names = [
        "metric", "worlds", f"area per scan, {config.scans} scans [%]",
        f"area per distance, {config.reach:g} m [%]", "mapped at the end [%]", "distance [m]",
        "bits removed [1000]", "wrong cells [per mille]", "ended early in", "choice [ms]",
    ]  # fmt: skip
    lines = []
    for metric in metrics_in(rows):
        scans = values_of(rows, metric, "scans")
        cells = [(100.0, 1, "area_scans"), (100.0, 1, "area_path"), (100.0, 1, "fraction"),
                 (1.0, 0, "distance"), (1.0, 2, "bits"), (1e3, 2, "wrong")]  # fmt: skip
        texts = [band(values_of(rows, metric, name)).text(by, n) for by, n, name in cells]
        early = np.count_nonzero(scans < config.scans)
        seconds = f"{1e3 * values_of(rows, metric, 'seconds').mean():.0f}"
        lines.append([f"`{metric}`", len(scans), *texts, early, seconds])
    return markdown(names, lines)


def comparisons(rows: list[Row], config: MetricsStudyConfig) -> str:
    """Each metric less `OWN`, paired by world, by kind of world, as a Markdown table."""
    kinds = ["all", *dict.fromkeys(row.kind for row in rows)]
    names = ["metric", *(f"per scan, {k}" for k in kinds), *(f"per distance, {k}" for k in kinds)]
    lines = [
        [
            f"`{metric}`",
            *(difference(rows, metric, "area_scans", kind).text(100.0, 1) for kind in kinds),
            *(difference(rows, metric, "area_path", kind).text(100.0, 1) for kind in kinds),
        ]
        for metric in metrics_in(rows)
        if metric != OWN
    ]
    return f"Area less that of `{OWN}`, in points, paired by world:\n\n" + markdown(names, lines)


def summary(rows: list[Row], seconds: float) -> dict[str, float | str]:
    """One flat object of figures."""
    figures: dict[str, float | str] = {"worlds": len({row.world for row in rows})}
    figures["seconds"] = round(seconds, 1)
    for metric in metrics_in(rows):
        for name in ("area_scans", "area_path", "fraction", "distance", "bits", "wrong", "seconds"):
            figures[f"{metric}.{name}"] = round(float(values_of(rows, metric, name).mean()), 5)
    return figures


_POINTS = 201
_SHOWN = (OWN, "scene_entropy", "stretched_scene_entropy", "weighted_scene_entropy")
_EQUATIONS = ("expected entropy reduction", "eq. (7)", "eqs. (7) and (8)", "eq. (9)")


def draw_curves(results: Results, config: MetricsStudyConfig, path: Path) -> None:
    """Coverage against scans and against distance, means over worlds; the band is that of `OWN`.

    PNG and SVG are written, `path` without suffix.
    """
    if not results:
        return
    metrics = list(dict.fromkeys(task.metric for task in results))
    styles = style_of(metrics)
    figure = Figure(figsize=(10.5, 5.6), layout="constrained")
    left, right = figure.subplots(1, 2, sharey=True)
    scans = np.arange(1.0, config.scans + 1.0)
    distances = np.linspace(0.0, config.reach, _POINTS)
    for metric in metrics:
        own = [run for task, run in results.items() if task.metric == metric]
        per_scan = np.array([curve(run.fraction, config.scans) for run in own])
        per_meter = np.array([fraction_at(run.distance, run.fraction, distances) for run in own])
        for axes, at, curves in ((left, scans, per_scan), (right, distances, per_meter)):
            if metric == OWN:
                draw_band(axes, at, curves, styles[metric], metric)
            else:  # eleven bands over each other would hide the curves
                axes.plot(at, curves.mean(axis=0), label=metric, **styles[metric])
    _label(left, "scans [-]", config.scans)
    _label(right, "distance moved [m]", config.reach)
    left.set_ylabel("fraction mapped [-]")
    handles, labels = left.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=4, fontsize=8)
    worlds = len({str(task.world) for task in results})
    title = f"Views chosen by each metric: {band_note(worlds)} (band: {OWN})"
    figure.suptitle(title, fontsize=10)
    save(figure, path)


def _label(axes: Any, name: str, last: float) -> None:
    axes.set_xlabel(name)
    axes.set_xlim(0.0, last)
    axes.set_ylim(0.0, 1.0)
    axes.grid(alpha=0.3)


def draw_unknown(shares: FloatArray, values: Mapping[str, FloatArray], path: Path) -> None:
    """What the printed metrics say of a view that is partly unknown.

    Args:
        shares: of the view that are unknown, shape (N,).
        values: by metric, shape (N,) each; as `values_by_share` gives them.
        path: without suffix; PNG and SVG are written.
    """
    styles = style_of(_SHOWN)
    figure = Figure(figsize=(6.0, 4.2), layout="constrained")
    axes = figure.subplots()
    for metric, name in zip(_SHOWN, _EQUATIONS, strict=True):
        largest = max(float(values[metric].max()), 1e-12)
        axes.plot(shares, values[metric] / largest, label=name, **styles[metric])
    axes.set_xlabel("share of the view that is unknown [-]")
    axes.set_ylabel("value, as share of the metric's own largest [-]")
    axes.set_xlim(0.0, 1.0)
    axes.set_ylim(0.0, 1.05)
    axes.grid(alpha=0.3)
    axes.legend(fontsize=8)
    save(figure, path)
