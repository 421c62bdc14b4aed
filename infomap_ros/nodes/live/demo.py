"""``make demo``: a simulated rover explores a rough world, six processes over DDS.

Leaves the map file, the map as .ply, a picture, the log of the run, summary.json and a
self-contained report.html in the output folder, and the logs of the nodes below ``log/``. Exits
with 1 and one clear line when it could not.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Sequence
from pathlib import Path

from rich.console import Console
from rich.status import Status

from infomap_ros.exploration.records.pose_predictions import prediction_figures
from infomap_ros.exploration.records.recorded_run import read_run
from infomap_ros.exploration.reports.report import write_report
from infomap_ros.mapping import VoxelMap
from infomap_ros.mapping.files.export import write_ply
from infomap_ros.mapping.files.pictures import draw_map_views
from infomap_ros.nodes.live.demo_command import run_demo_command
from infomap_ros.nodes.live.demo_exploration import (
    REPORT_FILE,
    check_not_failed,
    drop_results,
    empty_folder,
    exploration_parser,
    robot_results,
    status_line,
    task_parameters,
    write_summary,
)
from infomap_ros.nodes.live.live_exploration import LiveExploration
from infomap_ros.nodes.live.pose_comparison import PoseComparison
from infomap_ros.replay.mapping.map_files import MAP_FILE, PLY_FILE
from infomap_ros.simulation.worlds.scenes import make_world

_TIMEOUT = 3600.0  # [s]


def run_demo(options: argparse.Namespace, console: Console) -> dict[str, object]:
    """Explore and write everything; returns figures of the run, flat.

    Raises:
        InfomapError: it could not be done; says why.
    """
    out: Path = options.out
    empty_folder(out)
    world = make_world(options.world, options.seed)
    limits = {"max_views": options.max_views, "known_fraction": options.known_fraction}
    task = task_parameters(world, limits)
    parameters = {
        "simulator": {"world": options.world, "world_seed": options.seed},
        "map_fusion": {"voxel_size": options.voxel_size},
        "next_best_view": {"strategy": options.strategy, **task},
        "explorer": task,
    }
    start = time.monotonic()
    status = Status(status_line({}), console=console)
    with LiveExploration(out, parameters) as run, status:
        poses = PoseComparison(run)
        run.start()
        run.follow(lambda: status.update(status_line(run.figures)), _TIMEOUT)
        console.print(run.call("map_fusion/save"), highlight=False)
        results: dict[str, object] = {"world": options.world, "seed": options.seed}
        results |= robot_results(run.figures) | poses.figures() | drop_results(run.state)
    results["seconds"] = round(time.monotonic() - start, 1)
    write_results(out, results)
    check_not_failed(results, out)
    return results


def write_results(out: Path, results: dict[str, object]) -> None:
    """Write .ply, picture, summary and report from the saved map and the log of the run."""
    voxel_map = VoxelMap.load(out / MAP_FILE)
    write_ply(voxel_map, out / PLY_FILE)
    draw_map_views(voxel_map, out / "map.png")
    results |= {
        "known_voxels": voxel_map.known_voxels,
        "surface_voxels": voxel_map.surface_voxels,
        "memory_bytes": voxel_map.memory_bytes(),
        "voxel_size": voxel_map.config.voxel_size,
        **prediction_figures(read_run(out / "exploration.jsonl")),
    }
    write_summary(out, results)
    write_report(
        out / REPORT_FILE,
        out / "exploration.jsonl",
        voxel_map,
        f"Exploring {results['world']}, seed {results['seed']}",
        "A simulated rover with an arm and a stereo pair, each node a process of its own.",
        results,
    )


def main(arguments: Sequence[str] | None = None) -> int:
    """Command line of the demo."""
    about = __doc__.split("\n")[0]
    parser = exploration_parser("demo", about, "out/demo", max_views=60, voxel_size=0.05)
    parser.add_argument("--strategy", default="largest_information", help="that chooses views")
    options = parser.parse_args(arguments)
    return run_demo_command("demo", options.out, lambda console: run_demo(options, console))


if __name__ == "__main__":
    raise SystemExit(main())
