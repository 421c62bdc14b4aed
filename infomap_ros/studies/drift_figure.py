"""The figure of the drift study."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from infomap_ros.studies.common.bands import CONFIDENCE
from infomap_ros.studies.drift import DriftPanel
from infomap_ros.studies.drift_walk import METHODS, NECESSARY

_COLORS = {"printed": "#d55e00", "weighted": "#009e73", "default": "#08519c"}
_LABELS = {
    "printed": "printed method, eq. (14)",
    "weighted": "weighted, step by step",
    "default": "default (filter)",
}


def draw_drift(panels: Sequence[DriftPanel], paths: Sequence[str | Path]) -> None:
    """Draw the RMS position error over the steps, one panel per distance and redundancy.

    Args:
        panels: of `panels_of`.
        paths: files to write, PNG or SVG by their suffix.
    """
    distances = sorted({panel.distance for panel in panels}, reverse=True)
    redundancies = sorted({panel.redundancy for panel in panels})
    figure = Figure(figsize=(3.6 * len(redundancies), 3.1 * len(distances)), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(
        len(distances), len(redundancies), sharex=True, sharey="row", squeeze=False
    )
    for panel in panels:
        axis = axes[distances.index(panel.distance)][redundancies.index(panel.redundancy)]
        steps = np.arange(len(panel.rms("default")))
        for method in METHODS:
            low, high = (1e3 * edge[1:] for edge in panel.band(method))
            axis.fill_between(steps[1:], low, high, color=_COLORS[method], alpha=0.25, linewidth=0)
            axis.plot(
                steps[1:], 1e3 * panel.rms(method)[1:], color=_COLORS[method],
                label=_LABELS[method], linewidth=1.4,
            )  # fmt: skip
        axis.set_yscale("log")
        axis.grid(True, which="both", linewidth=0.3)
        count = NECESSARY * panel.redundancy
        axis.set_title(
            f"{1e3 * panel.distance:.0f} mm, {panel.redundancy}x ({count} fiducials)", fontsize=10
        )
    for axis in axes[-1]:
        axis.set_xlabel("step [-]")
    for row in axes:
        row[0].set_ylabel("RMS position error [mm]")
    runs = len(panels[0].errors["default"])
    axes[0][-1].legend(  # most fiducials, smallest errors: there is room above the curves
        fontsize=7, loc="upper right", title=f"{runs} runs, {100 * CONFIDENCE:.0f} % bands",
        title_fontsize=7,
    )  # fmt: skip
    for path in paths:
        figure.savefig(path, dpi=120)
