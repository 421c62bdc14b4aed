"""Figs. 17 and 18 over many worlds: what is run, and what it says.

infomap study rover --out DIR
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from infomap_ros.geometry.config import check_config, parameter
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.studies.common.bands import Band, band, ratio_band
from infomap_ros.studies.common.runs import in_all_worlds
from infomap_ros.studies.common.tables import markdown
from infomap_ros.studies.rover.explore import RoverConfig, RoverExploration, RoverTask

OWN = "largest_information"
_HERE = "infomap_ros.studies.rover.rasters"
RASTERS = (
    "raster",
    f"{_HERE}.SweepRaster",
    f"{_HERE}.VoxelRaster",
    f"{_HERE}.OneWayRaster",
)
"""Sequential scans with long, short and the shortest steps, and one that does not turn."""

Results = Mapping[RoverTask, RoverExploration]


@dataclass(frozen=True)
class RoverStudyConfig:
    """Size of the study.

    Raises:
        ConfigError: a value is out of its range.
    """

    worlds: int = parameter(5, "Seeded worlds.", low=1, high=1000)
    seed: int = parameter(1, "Of the first world.", low=0)
    strategies: tuple[str, ...] = parameter(
        (OWN, *RASTERS), "Names of strategies, or dotted paths of classes."
    )
    views: int = parameter(18, "At so many views strategies are compared.", low=2, high=1000)
    raster_views: int = parameter(
        41,
        "So many views the strategy `raster` takes in the first `raster_worlds` worlds.",
        low=2,
        high=1000,
    )
    raster_worlds: int = parameter(
        1000, "See `raster_views`; in the others it takes `views`.", low=0, high=1000
    )
    rover: RoverConfig = field(default_factory=RoverConfig)

    def __post_init__(self) -> None:
        check_config(self)


def quick(config: RoverStudyConfig) -> RoverStudyConfig:
    """A study of the same form that takes less than a minute."""
    rover = replace(config.rover, size=7.0, width=192, height=144)
    return replace(
        config,
        worlds=1,
        strategies=(OWN, "raster"),
        views=3,
        raster_views=4,
        rover=rover,
    )


def tasks_of(config: RoverStudyConfig) -> list[RoverTask]:
    """All explorations, world by world."""
    return [
        RoverTask(
            seed,
            strategy,
            views_of(strategy, config, number),
            config.rover,
        )
        for number, seed in enumerate(range(config.seed, config.seed + config.worlds))
        for strategy in config.strategies
    ]


def views_of(strategy: str, config: RoverStudyConfig, number: int = 0) -> int:
    """How many views a strategy takes in a world, of which the first has the number 0."""
    goes_on = strategy == RASTERS[0] and number < config.raster_worlds
    return max(config.views, config.raster_views) if goes_on else config.views


def complete(results: Results) -> dict[RoverTask, RoverExploration]:
    """What was explored by all strategies, for paired tables."""
    tasks = in_all_worlds(list(results), lambda task: task.seed, lambda task: task.label)
    return {task: results[task] for task in tasks}


def labels_of(results: Results) -> list[str]:
    """Strategies in order of appearance."""
    return list(dict.fromkeys(task.label for task in results))


def of_strategy(results: Results, label: str) -> dict[int, RoverExploration]:
    """Explorations by one strategy, by seed of the world."""
    return {task.seed: result for task, result in results.items() if task.label == label}


def points_after(results: Results, label: str, view: int) -> FloatArray:
    """Points mapped after so many views, shape (worlds,)."""
    return np.array([result.after(view) for result in of_strategy(results, label).values()])


def ratio(results: Results, label: str, own_view: int, view: int) -> Band:
    """Points that largest information maps in so many views, over those of another strategy.

    Args:
        results: of both.
        label: of the other strategy.
        own_view: number of views of largest information.
        view: number of views of the other.

    Returns:
        The geometric mean over the worlds in which both were to take so many views, with its band.
    """
    asked = {task: result for task, result in results.items() if task.views >= view}
    own, other = of_strategy(results, OWN), of_strategy(asked, label)
    both = [seed for seed in own if seed in other]
    mine = np.array([own[seed].after(own_view) for seed in both])
    theirs = np.array([other[seed].after(view) for seed in both])
    return ratio_band(mine, theirs) if both else band(np.empty(0))


@dataclass(frozen=True)
class Row:
    """Figures of one exploration.

    Attributes:
        world: its name.
        seed: of it.
        strategy: label.
        visible: points of the true surface that reachable views can see.
        views: taken.
        points: mapped after the views at which strategies are compared.
        points_end: mapped at the end.
        distance: way of the base until the views at which strategies are compared [m].
        contacts: that should not be.
        touched: what touched what in them.
        seconds: time of the processor for a view, with simulation, stereo, map and choice [s].
        ended: why.
    """

    world: str
    seed: int
    strategy: str
    visible: int
    views: int
    points: float
    points_end: float
    distance: float
    contacts: int
    touched: str
    seconds: float
    ended: str


def rows_of(results: Results, config: RoverStudyConfig) -> list[Row]:
    """One row per exploration."""
    return [_row(task, result, config) for task, result in results.items()]


def _row(task: RoverTask, result: RoverExploration, config: RoverStudyConfig) -> Row:
    last = min(config.views, len(result.points)) - 1
    return Row(
        task.config.world,
        task.seed,
        task.label,
        len(result.first_seen),
        len(result.points),
        float(result.points[last]),
        float(result.points[-1]),
        float(result.distance[last]),
        result.contacts,
        result.touched,
        float(np.diff(result.seconds).mean()) if len(result.seconds) > 1 else 0.0,
        result.ended,
    )


def overview(results: Results, config: RoverStudyConfig) -> str:
    """Points and ratios by strategy as a Markdown table."""
    few, many = config.views, config.raster_views
    names = [
        "strategy", "worlds", f"mapped points after {few} views [1000]", "share of the visible [%]",
        f"distance [m] in {few} views", f"{OWN}, {few} views: times as many as with {few} of it",
        f"... as with {many} of it",
    ]  # fmt: skip
    rows, lines = rows_of(results, config), []
    for label in labels_of(results):
        own = [row for row in rows if row.strategy == label]
        shares = np.array([row.points / row.visible for row in own])
        factors = [ratio(results, label, few, n).text(1.0, 2) for n in _compared_at(label, config)]
        lines.append([
            label, len(own), band(points_after(results, label, few)).text(1e-3, 1),
            band(shares).text(100.0, 1), band(np.array([r.distance for r in own])).text(1.0, 1),
            *[*factors, "", ""][:2],
        ])  # fmt: skip
    return markdown(names, lines)


def summary(results: Results, config: RoverStudyConfig, seconds: float) -> dict[str, float | str]:
    """One flat object of figures."""
    few = config.views
    worlds = len({task.seed for task in results})
    figures: dict[str, float | str] = {"worlds": worlds, "seconds": round(seconds, 1)}
    for label in labels_of(results):
        figures[f"{label}.points"] = round(float(points_after(results, label, few).mean()), 1)
        for view in _compared_at(label, config):
            found = ratio(results, label, few, view)
            figures[f"{label}.factor_against_{view}"] = round(found.mean, 3)
            figures[f"{label}.factor_against_{view}_half_width"] = round(found.half, 3)
    return {name: value for name, value in figures.items() if value == value}


def _compared_at(label: str, config: RoverStudyConfig) -> list[int]:
    """Numbers of views of a strategy with which largest information is compared."""
    if label == OWN:
        return []
    takes_many = views_of(label, config) >= config.raster_views > config.views
    return [config.views, config.raster_views] if takes_many else [config.views]


def curves_of(results: Iterable[RoverExploration], views: int, name: str) -> FloatArray:
    """Curves of one strategy, one per world, shape (worlds, views); they stay at their end.

    Args:
        results: of the strategy.
        views: length of the curves.
        name: "points" or "distance".
    """
    at = np.arange(views)
    return np.array([getattr(r, name)[np.minimum(at, len(r.points) - 1)] for r in results])
