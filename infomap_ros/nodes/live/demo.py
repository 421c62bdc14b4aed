"""``make demo``: a simulated rover explores a rough world, six processes over DDS.

Leaves the map file, the map as .ply, a picture, the log of the run, summary.json and a
self-contained report.html in the output folder, and the logs of the nodes below ``log/``. Exits
with 1 and one clear line when it could not.
"""

from __future__ import annotations

import argparse
import json
import shutil
import time
from collections.abc import Sequence
from pathlib import Path

from rich.console import Console
from rich.status import Status

from infomap_ros.errors import ProcessError
from infomap_ros.exploration.reports.report import write_report
from infomap_ros.exploration.task import TaskConfig
from infomap_ros.mapping import VoxelMap
from infomap_ros.mapping.files.export import write_ply
from infomap_ros.mapping.files.pictures import draw_map_views
from infomap_ros.nodes.live.demo_command import run_demo_command
from infomap_ros.nodes.live.live_exploration import LiveExploration
from infomap_ros.nodes.live.pose_comparison import PoseComparison
from infomap_ros.replay.mapping.map_files import MAP_FILE, PLY_FILE, SUMMARY_FILE
from infomap_ros.simulation.exploring.exploration_run import task_in
from infomap_ros.simulation.worlds.scenes import make_world

_TIMEOUT = 3600.0  # [s]


def run_demo(options: argparse.Namespace, console: Console) -> dict[str, object]:
    """Explore and write everything; returns figures of the run, flat.

    Raises:
        InfomapError: it could not be done; says why.
    """
    out: Path = options.out
    shutil.rmtree(out, ignore_errors=True)
    out.mkdir(parents=True)
    world = make_world(options.world, options.seed)
    region = task_in(world, TaskConfig(), world.T_world_target)
    task = {
        "task.max_views": options.max_views,
        "task.region_low": list(region.region_low),
        "task.region_high": list(region.region_high),
    }
    parameters = {
        "simulator": {"world": options.world, "world_seed": options.seed},
        "map_fusion": {"voxel_size": options.voxel_size},
        "next_best_view": {"strategy": options.strategy, **task},
        "explorer": task,
    }
    start = time.monotonic()
    status = Status("starting six nodes; kernels are compiled the first time", console=console)
    with LiveExploration(out, parameters) as run, status:
        poses = PoseComparison(run)
        run.start()
        run.follow(lambda: status.update(status_line(run)), _TIMEOUT)
        console.print(run.call("map_fusion/save"), highlight=False)
        figures, located = dict(run.figures), poses.figures()
        drops = run.state.drops()
    results: dict[str, object] = {
        "world": options.world,
        "seed": options.seed,
        "end": figures["state"].removeprefix("ended: "),
        "detail": figures["last reason"],
        "seconds": round(time.monotonic() - start, 1),
    }
    for name in ("views", "distance [m]", "known fraction", "mean sigma [m]"):
        results[name] = float(figures[name]) if name in figures else None
    results |= located
    results |= {f"dropped: {reason}": count for reason, count in drops.items()}
    write_results(out, results)
    if results["end"] == "failed":
        raise ProcessError(f"{results['detail']}; see {out / 'log'}")
    return results


def status_line(run: LiveExploration) -> str:
    """What the explorer is doing, and how far it is."""
    figures = run.figures
    if not figures:
        return "starting six nodes; kernels are compiled the first time"
    parts = [figures["state"], f"{figures['views']} views", f"{figures['distance [m]']} m"]
    if "known fraction" in figures:
        parts += [
            f"{100.0 * float(figures['known fraction']):.1f} % known",
            f"{float(figures['remaining entropy [bits]']):,.0f} bits left",
            f"mean sigma {1e3 * float(figures['mean sigma [m]']):.1f} mm",
        ]
    return ", ".join(parts)


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
    }
    (out / SUMMARY_FILE).write_text(json.dumps(results, indent=1) + "\n", encoding="utf-8")
    write_report(
        out / "report.html",
        out / "exploration.jsonl",
        voxel_map,
        f"Exploring {results['world']}, seed {results['seed']}",
        "A simulated rover with an arm and a stereo pair, each node a process of its own.",
        results,
    )


def main(arguments: Sequence[str] | None = None) -> int:
    """Command line of the demo."""
    parser = argparse.ArgumentParser(prog="infomap demo", description=__doc__.split("\n")[0])
    parser.add_argument("--out", type=Path, default=Path("out/demo"))
    parser.add_argument("--world", default="mars", help="mars, office or cave")
    parser.add_argument("--seed", type=int, default=1, help="of the world")
    parser.add_argument("--strategy", default="largest_information")
    parser.add_argument("--max-views", type=int, default=60)
    parser.add_argument("--voxel-size", type=float, default=0.05, help="[m]")
    options = parser.parse_args(arguments)
    return run_demo_command("demo", options.out, lambda console: run_demo(options, console))


if __name__ == "__main__":
    raise SystemExit(main())
