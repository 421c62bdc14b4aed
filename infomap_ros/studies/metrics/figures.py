"""The figures of the comparison of metrics."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.studies.common.figure_style import band_note, draw_band, save, style_of
from infomap_ros.studies.metrics.metrics_study import OWN, MetricsStudyConfig, Results, curve
from infomap_ros.studies.planar.measures import fraction_at

_POINTS = 201
_SHOWN = (OWN, "scene_entropy", "stretched_scene_entropy", "weighted_scene_entropy")
_EQUATIONS = ("expected entropy reduction", "eq. (7)", "eqs. (7) and (8)", "eq. (9)")


def draw_curves(results: Results, config: MetricsStudyConfig, path: Path) -> None:
    """Coverage against scans and against the way, means over worlds; the band is that of `OWN`.

    PNG and SVG are written, `path` without suffix.
    """
    if not results:
        return
    metrics = list(dict.fromkeys(task.metric for task in results))
    styles = style_of(metrics)
    figure = Figure(figsize=(10.5, 5.6), layout="constrained")
    FigureCanvasAgg(figure)
    left, right = figure.subplots(1, 2, sharey=True)
    scans = np.arange(1.0, config.scans + 1.0)
    way = np.linspace(0.0, config.reach, _POINTS)
    for metric in metrics:
        own = [run for task, run in results.items() if task.metric == metric]
        per_scan = np.array([curve(run.fraction, config.scans) for run in own])
        per_way = np.array([fraction_at(run.distance, run.fraction, way) for run in own])
        for axes, at, curves in ((left, scans, per_scan), (right, way, per_way)):
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
    FigureCanvasAgg(figure)
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
