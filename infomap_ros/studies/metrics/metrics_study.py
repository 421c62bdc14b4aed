"""The metrics compared: what is run, and what it says.

infomap study metrics --out DIR
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from infomap_ros.geometry.config import check_config, parameter
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.studies.common.bands import Band, band
from infomap_ros.studies.common.tables import markdown
from infomap_ros.studies.metrics.metric_run import MetricRun, MetricTask
from infomap_ros.studies.planar.explore import ExplorationConfig
from infomap_ros.studies.planar.measures import area_under_coverage
from infomap_ros.studies.planar.sensor import SensorConfig
from infomap_ros.studies.planar.tasks import WorldName
from infomap_ros.views.expected_information import METRICS

OWN = "expected_entropy_reduction"

Results = Mapping[MetricTask, MetricRun]


@dataclass(frozen=True)
class MetricsStudyConfig:
    """Size of the study.

    Raises:
        ConfigError: a value is out of its range.
    """

    kinds: tuple[str, ...] = parameter(("clutter", "rooms", "caves"), "Kinds of drawn worlds.")
    worlds: int = parameter(5, "Drawn worlds of each kind.", low=1, high=1000)
    seed: int = parameter(0, "Of the first world of each kind.", low=0)
    metrics: tuple[str, ...] = parameter(tuple(METRICS), "Names of metrics.")
    scans: int = parameter(100, "Scans of each exploration.", low=2, high=10_000)
    reach: float = parameter(
        1000.0, "Coverage is averaged over so much way.", unit="m", low=1.0, high=1e6
    )
    cell: float = parameter(
        1.0, "Edge of a cell of the worlds and of a voxel of the maps.", unit="m", low=0.1, high=5.0
    )
    candidates: int = parameter(400, "Candidate views of each choice.", low=10, high=100_000)
    sensor: SensorConfig = field(default_factory=SensorConfig)

    def __post_init__(self) -> None:
        check_config(self)


def tasks_of(config: MetricsStudyConfig) -> list[MetricTask]:
    """All explorations, world by world and of each kind in turn."""
    tasks = []
    for seed in range(config.seed, config.seed + config.worlds):
        exploration = ExplorationConfig(scans=config.scans, seed=seed, sensor=config.sensor)
        for kind in config.kinds:
            world = WorldName(kind, seed, cell=config.cell)
            tasks += [
                MetricTask(world, metric, exploration, config.candidates)
                for metric in config.metrics
            ]
    return tasks


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
        area_way: mean fraction mapped over the first `reach` metres.
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
        f"area per way, {config.reach:g} m [%]", "mapped at the end [%]", "way [m]",
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
    names = ["metric", *(f"per scan, {k}" for k in kinds), *(f"per way, {k}" for k in kinds)]
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
