"""How the figures of the studies look: colors for all eyes, curves with bands, PNG and SVG.

Means over worlds with confidence bands.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from scipy import stats

from infomap_ros.geometry.atomic_file import save_figure
from infomap_ros.geometry.transforms import FloatArray

CONFIDENCE = 0.95
"""Of all bands."""


@dataclass(frozen=True)
class Band:
    """A mean over worlds with the half width of its confidence band.

    Attributes:
        mean: over the worlds.
        half: by Student's t; NaN for a single world.
        count: of worlds.
    """

    mean: float
    half: float
    count: int

    def __str__(self) -> str:
        return f"{self.mean:.3g} ± {self.half:.2g}" if self.count > 1 else f"{self.mean:.3g}"

    def text(self, factor: float = 1.0, digits: int = 0) -> str:
        """For tables: mean and half width times a factor, "-" where there is no value.

        Args:
            factor: 100 for per cent.
            digits: after the point.
        """
        if not self.count:
            return "-"
        mean = f"{factor * self.mean:.{digits}f}"
        return mean if self.count < 2 else f"{mean} ± {factor * self.half:.{digits}f}"


def band(values: FloatArray) -> Band:
    """Mean of one value per world, shape (n,), with its band; NaN where there is none."""
    count = len(values)
    if count < 2:
        return Band(float(values[0]) if count else float("nan"), float("nan"), count)
    mean, half = curve_band(values[:, None])
    return Band(float(mean[0]), float(half[0]), count)


def ratio_band(own: FloatArray, other: FloatArray) -> Band:
    """Geometric mean of ratios, paired over worlds, shape (n,) each, positive.

    The band is that of the mean logarithm; of its two half widths, which differ, the larger.
    """
    logarithms = band(np.log(own / other))
    mean = float(np.exp(logarithms.mean))
    return Band(mean, mean * float(np.expm1(logarithms.half)), logarithms.count)


def curve_band(curves: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Mean and half width of the band of curves, shape (worlds, N) -> (N,) each.

    The half width is 0 for a single world.
    """
    count = len(curves)
    mean = curves.mean(axis=0)
    if count < 2:
        return mean, np.zeros_like(mean)
    quantile = float(stats.t.ppf(0.5 + 0.5 * CONFIDENCE, count - 1))
    return mean, np.asarray(quantile * stats.sem(curves, axis=0))


_COLORS = (
    "#000000", "#E69F00", "#56B4E9", "#009E73", "#D55E00", "#0072B2", "#CC79A7", "#999999",
    "#6A3D9A", "#B15928",
)  # fmt: skip
"""After M. Okabe and K. Ito, told apart by the color-blind; the last three added."""

_DASHES = ("-", "--", "-.", ":")
_LEAST_WORLDS = 3  # that a band is drawn for


def style_of(names: Sequence[str]) -> dict[str, dict[str, Any]]:
    """Color and dashes by name of the curve; the same in all figures of a study."""
    return {
        name: {
            "color": _COLORS[index % len(_COLORS)],
            "linestyle": _DASHES[index // 5 % len(_DASHES)],
            "linewidth": 1.6,
        }
        for index, name in enumerate(names)
    }


def draw_band(
    axes: Any, at: FloatArray, curves: FloatArray, style: dict[str, Any], name: str
) -> None:
    """Draw the mean of curves with its band; a band of two worlds would cover the whole figure.

    Args:
        axes: of matplotlib.
        at: shape (N,).
        curves: one per world, shape (worlds, N).
        style: of the mean.
        name: for the legend.
    """
    mean, half = curve_band(curves)
    axes.plot(at, mean, label=name, **style)
    if len(curves) >= _LEAST_WORLDS:
        axes.fill_between(at, mean - half, mean + half, color=style["color"], alpha=0.12, lw=0)


def band_note(worlds: int) -> str:
    """What the curves and bands are, for a caption."""
    band = f" and {100 * CONFIDENCE:.0f} % band" if worlds >= _LEAST_WORLDS else ""
    return f"mean{band} over {worlds} world{'s' if worlds > 1 else ''}"


def save(figure: Figure, path: Path) -> None:
    """Write PNG and SVG; `path` without suffix."""
    save_figure(figure, path.with_suffix(".png"), 110)
    save_figure(figure, path.with_suffix(".svg"))
