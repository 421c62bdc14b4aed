"""A picture of what a camera would see of a map."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure

from infomap_ros.mapping.voxel_map import DepthImage

_LEAST_SIGMA = 1e-4  # that has a color of its own [m]


def draw_depth_image(image: DepthImage, path: Path) -> None:
    """Draw depth and sigma side by side; white where nothing is seen.

    Args:
        image: see `VoxelMap.render_depth`.
        path: PNG file to write.

    Raises:
        OSError: the file cannot be written.
    """
    figure = Figure(figsize=(14.0, 5.0), layout="constrained")
    FigureCanvasAgg(figure)
    left, right = figure.subplots(1, 2)
    depth = left.imshow(image.depth, cmap="viridis_r", interpolation="nearest")
    figure.colorbar(depth, ax=left, label="depth [m]", shrink=0.8)
    sigma = np.maximum(image.sigma, _LEAST_SIGMA)
    highest = float(np.nanmax(sigma)) if np.isfinite(sigma).any() else 1.0
    scale = LogNorm(_LEAST_SIGMA, max(highest, 2.0 * _LEAST_SIGMA))
    drawn = right.imshow(sigma, cmap="magma", norm=scale, interpolation="nearest")
    figure.colorbar(drawn, ax=right, label="sigma of the depth [m]", shrink=0.8)
    for axes in (left, right):
        axes.set(xlabel="u [px]", ylabel="v [px]")
    figure.savefig(path, dpi=110)
