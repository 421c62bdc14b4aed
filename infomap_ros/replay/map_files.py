"""What mapping a bag leaves behind.

Pictures of a range measurement.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from infomap_ros.exploration.reports.report import write_map_report
from infomap_ros.geometry.atomic_file import save_figure, write_text
from infomap_ros.mapping.files.export import write_ply
from infomap_ros.mapping.files.pictures import draw_map_views
from infomap_ros.replay.map_run import MapRun
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
    axes = figure.add_subplot()
    scale = matplotlib.colormaps[colors].with_extremes(bad="0.8")
    image = axes.imshow(values, cmap=scale, vmin=low, vmax=max(high, low + 1e-9))
    axes.set_axis_off()
    figure.colorbar(image, ax=axes, label=label, shrink=0.9)
    save_figure(figure, path, 100)


MAP_FILE, PLY_FILE, SUMMARY_FILE = "map.infomap", "map.ply", "summary.json"
PAGE_FILE, PICTURE_FILE = "map.html", "map.png"

FILES = {
    PAGE_FILE: "the map in 3-D, in a browser",
    PICTURE_FILE: "the map from above and from the side, and its uncertainty",
    "depth.png": "the first range measurement",
    "sigma.png": "its standard deviation",
    PLY_FILE: "the surface, for CloudCompare or MeshLab",
    MAP_FILE: "the map itself, for infomap show and VoxelMap.load",
    SUMMARY_FILE: "the figures of the run",
}
"""What `write_map_files` leaves, what a person looks at first at the beginning."""


def write_map_files(run: MapRun, out: Path) -> dict[str, int | float | str]:
    """Write map file, point cloud, pictures and summary.

    Args:
        run: a finished run.
        out: folder; made if it is not there.

    Returns:
        The summary.

    Raises:
        OSError: something cannot be written.
    """
    out.mkdir(parents=True, exist_ok=True)
    run.map.save(out / MAP_FILE)
    write_ply(run.map, out / PLY_FILE)
    name, path = run.name, np.array(run.camera_path)
    title = f"{name}, frame {run.inputs.map_frame}"
    draw_map_views(run.map, out / PICTURE_FILE, title, path)
    if run.first is not None:
        draw_depth(run.first.cloud, out / "depth.png")
        draw_sigma(run.first.cloud, out / "sigma.png")
    summary = run.summary()
    write_map_report(out / PAGE_FILE, run.map, name, figures=summary, camera_path=path)
    write_text(out / SUMMARY_FILE, json.dumps(summary, indent=1) + "\n")
    return summary
