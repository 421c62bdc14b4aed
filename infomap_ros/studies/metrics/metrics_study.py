"""The metrics compared: what is run, and what it says.

infomap study metrics --out DIR
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from infomap_ros.geometry.config import parameter
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.studies.common.bands import Band, band
from infomap_ros.studies.common.runs import in_all_worlds
from infomap_ros.studies.common.tables import markdown
from infomap_ros.studies.metrics.metric_run import MetricRun, MetricTask
from infomap_ros.studies.metrics.published_metrics import EVERY_METRIC
from infomap_ros.studies.planar.explore import ExplorationConfig
from infomap_ros.studies.planar.measures import area_under_coverage
from infomap_ros.studies.planar.study_config import OneSensorConfig
from infomap_ros.studies.planar.tasks import WorldName

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
        area_way: mean fraction mapped over the first `reach` meters.
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
    area_way: float
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
        cells = [(100.0, 1, "area_scans"), (100.0, 1, "area_way"), (100.0, 1, "fraction"),
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
            *(difference(rows, metric, "area_way", kind).text(100.0, 1) for kind in kinds),
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
        for name in ("area_scans", "area_way", "fraction", "distance", "bits", "wrong", "seconds"):
            figures[f"{metric}.{name}"] = round(float(values_of(rows, metric, name).mean()), 5)
    return figures
