"""What a strategy saves against others on the way to a share mapped, world by world."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from infomap_ros.studies.common.bands import CONFIDENCE, band
from infomap_ros.studies.common.figure_style import save, style_of
from infomap_ros.studies.planar.planar_study import Row, kinds_in, savings_of

_MARKERS = {"exact": "o", "at least": "^", "at most": "v"}
_SPREAD = 0.5  # width over which the kinds of worlds lie apart


def draw_savings(
    rows: Sequence[Row], own: str, others: Sequence[str], share: float, path: Path
) -> None:
    """Draw one point per world and other strategy, means with their bands; PNG and SVG.

    Args:
        rows: of all strategies and worlds.
        own: strategy that is compared with
        others: these.
        share: of the world, to which ways are compared.
        path: without suffix.
    """
    figure = Figure(figsize=(1.9 * len(others) + 2.2, 3.8), layout="constrained")
    FigureCanvasAgg(figure)
    axes, kinds = figure.subplots(), kinds_in(rows)
    styles, bounds = style_of(["mean", *kinds]), set[str]()
    for place, other in enumerate(others):
        for kind, shift in zip(kinds, np.linspace(-0.5, 0.5, len(kinds)) * _SPREAD, strict=True):
            for saved in savings_of(rows, own, other, kind):
                marker, color = _MARKERS.get(saved.kind), styles[kind]["color"]
                bounds.add(saved.kind)
                if marker:
                    axes.plot(place + shift, 100.0 * saved.share, marker, color=color, ms=5)
        known = [one.share for one in savings_of(rows, own, other) if one.kind in _MARKERS]
        mean = band(100.0 * np.array(known))
        axes.errorbar(place + 0.4, mean.mean, np.nan_to_num(mean.half), fmt="ks", capsize=4)
    for kind in kinds:
        axes.plot([], [], "o", color=styles[kind]["color"], label=kind)
    for name in sorted(bounds & {"at least", "at most"}):
        axes.plot([], [], _MARKERS[name], color="#777777", label=name)
    axes.plot([], [], "ks", label=f"mean, {100 * CONFIDENCE:.0f} % band")
    axes.axhline(0.0, color="black", linewidth=0.8)
    axes.set_xticks(range(len(others)), others)
    axes.set_ylabel(f"way saved by {own}\nuntil {100 * share:g} % are mapped [%]")
    axes.grid(axis="y", alpha=0.3)
    figure.legend(loc="outside right upper", fontsize=8)
    save(figure, path)
