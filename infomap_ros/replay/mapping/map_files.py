"""What mapping a bag leaves behind."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from infomap_ros.exploration.reports.report import write_map_report
from infomap_ros.geometry.atomic_file import write_text
from infomap_ros.mapping.files.export import write_ply
from infomap_ros.mapping.files.pictures import draw_map_views
from infomap_ros.replay.mapping.map_run import MapRun
from infomap_ros.replay.mapping.range_pictures import draw_depth, draw_sigma

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
