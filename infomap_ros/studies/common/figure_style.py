"""How the figures of the studies look: colors for all eyes, curves with bands, PNG and SVG."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure

from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.studies.common.bands import CONFIDENCE, curve_band

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
    figure.savefig(path.with_suffix(".png"), dpi=110)
    figure.savefig(path.with_suffix(".svg"))
