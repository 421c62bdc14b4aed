"""Figs. 10, 11, 13 and 14, with more worlds and beside baselines: what is run, and what it says.

infomap study planar --out DIR
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from infomap_ros.geometry.config import parameter
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.studies.figure_style import Band, band
from infomap_ros.studies.planar.explore import ExplorationConfig
from infomap_ros.studies.planar.tasks import (
    DrawnWorldsConfig,
    OneSensorConfig,
    Record,
    Saving,
    Task,
    WorldName,
    area_under_coverage,
    distance_to,
    saving,
)
from infomap_ros.studies.planar.world import BoolArray, SensorConfig
from infomap_ros.studies.runs import in_all_worlds

PAPER = ("random", "raster", "largest_unknown", "smallest_known", "largest_information")
"""The five strategies of the paper."""

_HERE = "infomap_ros.studies.baselines"
BASELINES = (
    f"{_HERE}.frontiers.NearestFrontier",
    f"{_HERE}.frontier_tour.FrontierTour",
    f"{_HERE}.view_tree.ViewTree",
    f"{_HERE}.view_tree.AutonomousExploration",
)
"""What the package's strategies are compared with, by dotted path."""

OWN = ("largest_information", "look_ahead")
"""The package's own strategies, which all others are compared with."""


@dataclass(frozen=True)
class PlanarStudyConfig(OneSensorConfig):
    """Size of the study.

    Raises:
        ConfigError: a value is out of its range.
    """

    strategies: tuple[str, ...] = parameter(
        (*PAPER, "look_ahead", *BASELINES),
        "Names of strategies, or dotted paths of classes.",
    )
    max_scans: int = parameter(
        600,
        "So many scans may be taken on the way to `share`. Four of the paper's strategies stop "
        "where the figures end, after `scans` and `reach`.",
        low=2,
        high=10_000,
    )
    share: float = parameter(
        0.9, "Share of a world to which distances are compared.", low=0.01, high=1.0
    )
    look_limit: float = parameter(
        0.3,
        "After so many looks in vain a voxel is given up: one from up to 0.84 of the range.",
        low=0.01,
        high=1e6,
    )


def quick(config: PlanarStudyConfig) -> PlanarStudyConfig:
    """A study of the same form that takes less than a minute."""
    return replace(
        config,
        worlds=min(config.worlds, 1),
        kinds=config.kinds[:1],
        strategies=("random", "largest_information", "look_ahead"),
        scans=12,
        max_scans=15,
        candidates=120,
    )


def tasks_of(config: PlanarStudyConfig, floor_plans: Sequence[Path] = ()) -> list[Task]:
    """All explorations, world by world and of each kind in turn."""
    worlds = [WorldName("fig10", config.seed, cell=config.cell)]
    for number in range(config.worlds):
        worlds += config.drawn(number)
        if number == 0:
            worlds += [WorldName("floor plans", 0, str(path), config.cell) for path in floor_plans]
    return [_task(world, strategy, config) for world in worlds for strategy in config.strategies]


def _task(world: WorldName, strategy: str, config: PlanarStudyConfig) -> Task:
    stops = strategy in PAPER and strategy not in OWN
    exploration = ExplorationConfig(
        scans=config.max_scans,
        enough=config.share,
        min_scans=config.scans if stops else config.max_scans,
        min_path_length=config.reach if stops else 0.0,
        seed=world.seed,
        sensor=config.sensor,
    )
    look_limit = None if stops or strategy in BASELINES else config.look_limit
    return Task(world, strategy, exploration, config.candidates, look_limit=look_limit)


@dataclass(frozen=True)
class TeamStudyConfig(DrawnWorldsConfig):
    """Size of the study of several sensors, Fig. 12.

    Raises:
        ConfigError: a value is out of its range.
    """

    strategies: tuple[str, ...] = parameter(
        (*PAPER, "look_ahead"), "Names of strategies, or dotted paths of classes."
    )
    sensors: int = parameter(2, "That explore together.", low=2, high=32)
    scans: int = parameter(40, "Scans of all sensors together.", low=2, high=10_000)
    sensor: SensorConfig = field(
        default_factory=lambda: SensorConfig(field_of_view=75.0, max_range=10.0)
    )


def team_tasks(config: TeamStudyConfig) -> list[Task]:
    """All explorations of the study of several sensors, world by world."""
    worlds = [WorldName("fig10", config.seed, cell=config.cell)]
    for number in range(config.worlds):
        worlds += config.drawn(number)
    return [
        Task(
            world,
            strategy,
            ExplorationConfig(scans=config.scans, seed=world.seed, sensor=config.sensor),
            config.candidates,
            config.sensors,
        )
        for world in worlds
        for strategy in config.strategies
    ]


@dataclass(frozen=True)
class Row:
    """Figures of one exploration.

    Attributes:
        world: its name.
        kind: of the world.
        strategy: label.
        scans: taken.
        fraction: mapped after the scans of the figures, or `share` where that came before.
        fraction_end: mapped at the end.
        area: mean fraction mapped over the first `reach` meters, no more than `share` counted.
        distance: moved until the end [m].
        distance_to_share: moved until `share` was mapped [m]; inf where it never was.
        seconds: of the choice of a view, mean time of the processor [s].
        max_seconds: the longest [s].
    """

    world: str
    kind: str
    strategy: str
    scans: int
    fraction: float
    fraction_end: float
    area: float
    distance: float
    distance_to_share: float
    seconds: float
    max_seconds: float


def row_of(record: Record, config: PlanarStudyConfig) -> Row:
    """Figures of one record."""
    task, result = record.task, record.result
    last = min(config.scans, len(result.fraction)) - 1
    capped, chosen = np.minimum(result.fraction, config.share), result.seconds[1:]
    return Row(
        str(task.world),
        task.world.kind,
        task.label,
        len(result.fraction),
        float(min(result.fraction[last], config.share)),
        float(result.fraction[-1]),
        area_under_coverage(result.distance, capped, config.reach),
        float(result.distance[-1]),
        distance_to(result.distance, result.fraction, config.share),
        float(chosen.mean()) if len(chosen) else 0.0,
        float(chosen.max(initial=0.0)),
    )


@dataclass(frozen=True)
class Comparison:
    """One strategy against another over the worlds that both have explored.

    Attributes:
        kind: of the worlds, or "all".
        own: label.
        other: label.
        area: difference of the areas under the coverage curve.
        saved: share of the distance to `share` that is saved; see `measures.saving`.
        at_least: worlds of `saved` where the other did not get so far: a lower bound is counted.
        at_most: worlds of `saved` where the own did not get so far: an upper bound is counted.
        unknown: worlds without a bound, which do not count in `saved`.
    """

    kind: str
    own: str
    other: str
    area: Band
    saved: Band
    at_least: int
    at_most: int
    unknown: int


def compare(rows: Sequence[Row], own: str, other: str, kind: str = "all") -> Comparison:
    """Compare two strategies, paired over worlds."""
    areas = [mine.area - theirs.area for mine, theirs in _pairs(rows, own, other, kind)]
    found = savings_of(rows, own, other, kind)
    saved = np.array([one.share for one in found if one.kind != "unknown"])
    kinds = [one.kind for one in found]
    counts = (kinds.count(name) for name in ("at least", "at most", "unknown"))
    return Comparison(kind, own, other, band(np.array(areas)), band(saved), *counts)


def savings_of(rows: Sequence[Row], own: str, other: str, kind: str = "all") -> list[Saving]:
    """What one strategy saves against another on the way to `share`, world by world."""
    pairs = _pairs(rows, own, other, kind)
    return [saving(_distances(mine), _distances(theirs)) for mine, theirs in pairs]


def _pairs(rows: Sequence[Row], own: str, other: str, kind: str) -> list[tuple[Row, Row]]:
    by_world: dict[str, dict[str, Row]] = {}
    for row in rows:
        if kind in ("all", row.kind):
            by_world.setdefault(row.world, {})[row.strategy] = row
    return [(w[own], w[other]) for w in by_world.values() if own in w and other in w]


def _distances(row: Row) -> tuple[float, float]:
    return row.distance_to_share, row.distance


def least_distances(rows: Sequence[Row], strategy: str) -> tuple[FloatArray, BoolArray]:
    """Distance to `share` in each world, at least, (n,) [m], and whether it was reached, (n,)."""
    distances = values_of(rows, strategy, "distance_to_share")
    arrived = np.isfinite(distances)
    return np.where(arrived, distances, values_of(rows, strategy, "distance")), arrived


def complete(records: Sequence[Record]) -> list[Record]:
    """The records of the worlds that all strategies have explored, for paired tables."""
    return in_all_worlds(records, lambda r: str(r.task.world), lambda r: r.task.label)


def kinds_in(rows: Sequence[Row]) -> list[str]:
    """Kinds of worlds in order of appearance."""
    return list(dict.fromkeys(row.kind for row in rows))


def values_of(rows: Sequence[Row], strategy: str, name: str, kind: str = "all") -> FloatArray:
    """One figure of a strategy in all worlds of a kind, shape (n,)."""
    return np.array(
        [
            float(getattr(row, name))
            for row in rows
            if row.strategy == strategy and kind in ("all", row.kind)
        ]
    )
