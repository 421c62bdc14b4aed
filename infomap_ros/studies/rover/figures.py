"""The figures of the rover's study: mapped points against views, and what was mapped where."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from numpy.typing import NDArray

from infomap_ros.studies.common.figure_style import band_note, draw_band, save, style_of
from infomap_ros.studies.rover.explore import RoverExploration, RoverTask
from infomap_ros.studies.rover.rover_study import (
    Results,
    RoverStudyConfig,
    curves_of,
    labels_of,
)

_Style = dict[str, Any]
_UNMAPPED, _MAPPED, _VIEWS = "#cccccc", "#0072B2", "#D55E00"


def draw_curves(results: Results, config: RoverStudyConfig, path: Path) -> None:
    """Fig. 17, and the way that the views took; PNG and SVG, `path` without suffix."""
    labels = labels_of(results)
    styles = style_of(labels)
    figure = Figure(figsize=(10.0, 4.7), layout="constrained")
    FigureCanvasAgg(figure)
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
    FigureCanvasAgg(figure)
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
