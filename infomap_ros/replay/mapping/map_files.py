"""What mapping a bag leaves behind."""

from __future__ import annotations

import json
from pathlib import Path

from infomap_ros.mapping.files.export import write_ply
from infomap_ros.mapping.files.pictures import draw_map_views
from infomap_ros.replay.mapping.map_run import MapRun
from infomap_ros.replay.mapping.range_pictures import draw_depth, draw_sigma

MAP_FILE, PLY_FILE, SUMMARY_FILE = "map.infomap", "map.ply", "summary.json"


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
    draw_map_views(run.map, out / "map.png")
    if run.first is not None:
        draw_depth(run.first.cloud, out / "depth.png")
        draw_sigma(run.first.cloud, out / "sigma.png")
    summary = run.summary()
    (out / SUMMARY_FILE).write_text(json.dumps(summary, indent=1) + "\n", encoding="utf-8")
    return summary
