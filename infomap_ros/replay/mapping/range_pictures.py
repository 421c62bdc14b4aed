"""Pictures of a range measurement."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from numpy.typing import NDArray

from infomap_ros.stereo import RangeCloud

_WIDTH = 9.0  # of a picture [in]


def draw_depth(cloud: RangeCloud, path: Path) -> None:
    """Draw the depth of every pixel; what was not measured stays gray.

    Args:
        cloud: a measurement.
        path: PNG file to write.

    Raises:
        OSError: it cannot be written.
    """
    _draw(cloud.range_image, "depth [m]", "viridis_r", path)


def draw_sigma(cloud: RangeCloud, path: Path) -> None:
    """Draw the standard deviation of every pixel's depth; arguments as in `draw_depth`."""
    variance = cloud.covariance_triangles[..., 5].astype(np.float64)
    _draw(1e3 * np.sqrt(variance), "standard deviation of depth [mm]", "magma", path)


def _draw(values: NDArray[Any], label: str, colors: str, path: Path) -> None:
    """One image with its scale, from the 1st to the 99th percentile of what was measured."""
    height, width = values.shape
    measured = values[np.isfinite(values)]
    low, high = np.percentile(measured, [1.0, 99.0]) if len(measured) else (0.0, 1.0)
    figure = Figure(figsize=(_WIDTH, _WIDTH * height / width), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.add_subplot()
    scale = matplotlib.colormaps[colors].with_extremes(bad="0.8")
    image = axes.imshow(values, cmap=scale, vmin=low, vmax=max(high, low + 1e-9))
    axes.set_axis_off()
    figure.colorbar(image, ax=axes, label=label, shrink=0.9)
    figure.savefig(path, dpi=100)
