"""The figure of the study of pose consistency."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from scipy import stats

from infomap_ros.studies.pose_consistency import ScenarioResult

_COLORS = ("#08519c", "#009e73", "#d55e00")


def draw_nees(results: Sequence[ScenarioResult], path: str | Path) -> None:
    """Draw the distribution of the poses' NEES beside the chi-square one that it should be.

    Args:
        results: of `run_pose_consistency`; those with a moving body are left out.
        path: of the PNG file.
    """
    shown = [result for result in results if result.scenario.speed == 0.0]
    figure = Figure(figsize=(4.2 * len(shown), 3.4), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(1, len(shown), sharey=True, squeeze=False)[0]
    x = np.linspace(0.0, 25.0, 300)
    for axis, result in zip(axes, shown, strict=True):
        curves = (
            ("half way", result.halfway), ("last", result.last), ("kept", result.kept)
        )  # fmt: skip
        for (name, values), color in zip(curves, _COLORS, strict=True):
            ordered = np.sort(values)
            share = np.arange(1, len(ordered) + 1) / len(ordered)
            axis.step(ordered, share, where="post", color=color, label=f"{name} pose")
        axis.plot(x, stats.chi2.cdf(x, 6), "k--", linewidth=1.0, label="chi-square, 6 d.o.f.")
        axis.set_xlim(0.0, 25.0)
        axis.set_title(result.scenario.name, fontsize=10)
        axis.set_xlabel("NEES [-]")
        axis.grid(True, linewidth=0.3)
    axes[0].set_ylabel("share of runs below [-]")
    axes[0].legend(fontsize=8, loc="lower right")
    figure.savefig(path, dpi=120)
