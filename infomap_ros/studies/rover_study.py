"""Figs. 17 and 18 over many worlds: what is run, and what it says.

infomap study rover --out DIR

The figures of the rover's study: mapped points against views, and what was mapped where.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from numpy.typing import NDArray

from infomap_ros.geometry.config import check_config, parameter
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.studies.figure_style import (
    Band,
    band,
    band_note,
    draw_band,
    ratio_band,
    save,
    style_of,
)
from infomap_ros.studies.rover_exploration import RoverConfig, RoverExploration, RoverTask
from infomap_ros.studies.runs import in_all_worlds, markdown

OWN = "largest_information"
_HERE = "infomap_ros.studies.rover_exploration"
RASTERS = (
    "raster",
    f"{_HERE}.SweepRaster",
    f"{_HERE}.VoxelRaster",
    f"{_HERE}.OneDirectionRaster",
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
        distance: driven by the base until the views at which strategies are compared [m].
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


_Style = dict[str, Any]
_UNMAPPED, _MAPPED, _VIEWS = "#cccccc", "#0072B2", "#D55E00"


def draw_curves(results: Results, config: RoverStudyConfig, path: Path) -> None:
    """Fig. 17, and the path that the views took; PNG and SVG, `path` without suffix."""
    labels = labels_of(results)
    styles = style_of(labels)
    figure = Figure(figsize=(10.0, 4.7), layout="constrained")
    left, right = figure.subplots(1, 2)
    for label in labels:
        own = {task: result for task, result in results.items() if task.label == label}
        _draw_strategy(left, own, config, ("points", 1e-3), styles[label])
        _draw_strategy(right, own, config, ("distance", 1.0), styles[label])
    _label(left, "mapped points of the true surface [1000]", config)
    _label(right, "distance driven [m]", config)
    handles, names = left.get_legend_handles_labels()
    figure.legend(handles, names, loc="outside lower center", ncols=len(names), fontsize=8)
    worlds = len({task.seed for task in results})
    figure.suptitle(f"Fig. 17 over many worlds: {band_note(worlds)}", fontsize=10)
    save(figure, path)


def _draw_strategy(
    axes: Any, own: Results, config: RoverStudyConfig, value: tuple[str, float], style: _Style
) -> None:
    """The mean with its band, and a thin line for each world in which more views were taken."""
    name, scale = value
    label = next(iter(own)).label
    at = np.arange(1.0, config.views + 1.0)
    draw_band(axes, at, scale * curves_of(own.values(), config.views, name), style, label)
    thin, note = {**style, "linewidth": 0.8}, f"{label}, each world"
    for task, result in own.items():
        if task.views > config.views:
            curve = scale * curves_of([result], task.views, name)[0]
            axes.plot(np.arange(1.0, task.views + 1.0), curve, label=note, **thin)
            note = "_"  # one line of the legend for all worlds


def _label(axes: Any, name: str, config: RoverStudyConfig) -> None:
    axes.set_xlabel("views [-]")
    axes.set_ylabel(name)
    axes.set_xlim(0.0, max(config.views, config.raster_views))
    axes.set_ylim(bottom=0.0)
    axes.axvline(config.views, color="#999999", linewidth=0.8, linestyle=":")
    axes.grid(alpha=0.3)


def draw_regions(results: Results, path: Path) -> None:
    """Fig. 18: what is mapped of the first world, from above, and the places of the views."""
    first = next(iter(results)).seed
    shown = [(task, result) for task, result in results.items() if task.seed == first]
    figure = Figure(figsize=(3.6 * len(shown), 4.8), layout="constrained")
    panels = figure.subplots(1, len(shown), sharex=True, sharey=True, squeeze=False)[0]
    for axes, (task, result) in zip(panels, shown, strict=True):
        _draw_region(axes, task, result)
    panels[0].set_ylabel("y [m]")
    _add_legend(figure)
    save(figure, path)


def _add_legend(figure: Figure) -> None:
    marks = (
        (_MAPPED, "mapped surface"),
        (_UNMAPPED, "not mapped"),
        (_VIEWS, "views, path between"),
    )
    handles = [
        Line2D([], [], linestyle="", marker="o", markersize=5, color=color, label=name)
        for color, name in marks
    ]
    figure.legend(handles=handles, loc="outside lower center", ncols=len(marks), fontsize=8)


def _draw_region(axes: Any, task: RoverTask, result: RoverExploration) -> None:
    mapped = result.first_seen > 0
    for chosen, color in ((~mapped, _UNMAPPED), (mapped, _MAPPED)):
        _dots(axes, result.surface[chosen], color)
    cameras = result.cameras[:, :3, 3]
    axes.plot(cameras[:, 0], cameras[:, 1], "-", color=_VIEWS, linewidth=0.6)
    axes.plot(cameras[:, 0], cameras[:, 1], "o", color=_VIEWS, markersize=3)
    share = 100.0 * float(np.mean(mapped))
    axes.set_title(f"{task.label}\n{len(cameras)} views: {share:.0f} % mapped", fontsize=9)
    axes.set_xlabel("x [m]")
    axes.set_aspect("equal")


def _dots(axes: Any, points: NDArray[np.float32], color: str) -> None:
    axes.plot(points[:, 0], points[:, 1], ".", color=color, markersize=0.8, rasterized=True)


def all_figures(results: Results, config: RoverStudyConfig, out: Path) -> Sequence[Path]:
    """Draw both; returns where, without suffix. Nothing is drawn where nothing was run."""
    if not results:
        return ()
    paths = out / "rover_curves", out / "rover_regions"
    draw_curves(results, config, paths[0])
    draw_regions(results, paths[1])
    return paths
