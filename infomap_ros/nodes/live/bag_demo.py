"""``make demo-bag``: map the shipped bag through the live nodes, four processes over DDS.

Leaves the map file, the map as .ply, pictures, summary.json and report.html in the output folder,
and the logs of the nodes below ``log/``. Exits with 1 and one clear line when it could not.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Sequence
from pathlib import Path

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

from infomap_ros.errors import BagError, ProcessError
from infomap_ros.exploration.reports.report import write_map_report
from infomap_ros.geometry.atomic_file import write_text
from infomap_ros.geometry.resources import find_share
from infomap_ros.mapping import VoxelMap
from infomap_ros.mapping.files.export import surface_vertices, write_ply
from infomap_ros.mapping.files.pictures import draw_map_views
from infomap_ros.nodes.live.demo_command import run_demo_command, say_page
from infomap_ros.nodes.live.live_run import LEFT, LiveRun
from infomap_ros.nodes.live.pictures import LivePictures
from infomap_ros.nodes.live.pose_comparison import PoseComparison
from infomap_ros.replay.bags.reader import BagReader
from infomap_ros.replay.mapping.map_files import MAP_FILE, PLY_FILE, SUMMARY_FILE

BAG = "bags/rover_rocks"
_START_TIMEOUT = 300.0  # [s]; kernels are compiled the first time
_PAIR_TIMEOUT = 10.0  # [s]
_LEAST_SHARE = 0.9  # of the pairs must be in the map


def run_demo(bag: Path, out: Path, voxel_size: float, console: Console) -> dict[str, object]:
    """Map the bag and write everything.

    Args:
        bag: with a raw stereo pair and camera infos; with odometry, joint states and a robot
            description the map begins where odometry does.
        out: folder for the results.
        voxel_size: [m].
        console: for the progress.

    Returns:
        Figures of the run, flat.

    Raises:
        InfomapError: it could not be done; says why.
    """
    out.mkdir(parents=True, exist_ok=True)
    pairs = count_pairs(bag)
    player = {"acknowledged": True, "paced_topic": f"/{LEFT}"}
    start = time.monotonic()
    fusion = {"voxel_size": voxel_size}
    map_file = out / MAP_FILE
    with LiveRun(bag, out, player, fusion=fusion, map_file=map_file, localization={}) as run:
        say_page(run.open_page(), console)
        pictures, poses = LivePictures(run), PoseComparison(run)
        console.print("starting stereo_range, fiducial_localization and map_fusion")
        run.start(_START_TIMEOUT)
        follow(run, pairs, console)
        console.print(run.call("map_fusion/save"))
        seconds = time.monotonic() - start
        drops = run.state.drops()
        figures: dict[str, object] = {
            "pairs": pairs,
            "frames": run.state.count("map_fusion"),
            "seconds": round(seconds, 2),
            "frames_dropped": pairs - run.state.count("map_fusion"),
        }
        figures |= {f"dropped: {reason}": count for reason, count in drops.items()}
        figures |= poses.figures()
        drawn = pictures.write(out)
    results = write_results(out, bag, figures, drawn)
    fused = run.state.count("map_fusion")
    if fused < _LEAST_SHARE * pairs:
        raise ProcessError(f"only {fused} of {pairs} pairs were mapped; see {out / 'log'}")
    return results


def count_pairs(bag: Path) -> int:
    """Number of left images in the bag.

    Raises:
        BagError: it has none.
    """
    with BagReader(bag) as reader:
        channel = reader.topics.get(f"/{LEFT}")
        if channel is None or not channel.count:
            raise BagError(f"{bag} has no images on /{LEFT}; it has {', '.join(reader.topics)}")
        return channel.count


def follow(run: LiveRun, pairs: int, console: Console) -> None:
    """Show progress until the bag has been played and fused."""
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
    )
    with Progress(*columns, console=console) as progress:
        task = progress.add_task("starting bag_player", total=pairs)

        def show() -> None:
            voxels = run.state.figures.get("map_fusion", {}).get("known voxels", "0")
            text = f"pairs mapped, {int(voxels):,} voxels"
            progress.update(task, completed=run.state.count("map_fusion"), description=text)

        run.spin_until(lambda: run.state.count("map_fusion") > 0, "the first scan", _START_TIMEOUT)
        run.spin_until(lambda: run.settled, "the end", _PAIR_TIMEOUT * pairs, show)
        show()


def write_results(
    out: Path, bag: Path, figures: dict[str, object], drawn: Sequence[tuple[Path, str]]
) -> dict[str, object]:
    """Write .ply, pictures, summary and report from the saved map."""
    voxel_map = VoxelMap.load(out / MAP_FILE)
    write_ply(voxel_map, out / PLY_FILE)
    draw_map_views(voxel_map, out / "map.png")
    sigmas = surface_vertices(voxel_map)["sigma"]
    figures |= {
        "known_voxels": voxel_map.known_voxels,
        "surface_voxels": voxel_map.surface_voxels,
        "mean_sigma_mm": round(1e3 * float(sigmas.mean()), 2),
        "memory_bytes": voxel_map.memory_bytes(),
        "voxel_size": voxel_map.config.voxel_size,
    }
    write_text(out / SUMMARY_FILE, json.dumps(figures, indent=1) + "\n")
    introduction = (
        f"The bag {bag.name}, played through stereo_range, fiducial_localization and map_fusion as "
        "separate processes. "
        f"The map is in {MAP_FILE}, as points with probability and sigma in {PLY_FILE}."
    )
    caption = "The map from above and from the side"
    write_map_report(
        out / "report.html",
        voxel_map,
        "infomap_ros: a stereo bag becomes a map",
        introduction,
        figures,
        [(out / "map.png", caption), *drawn],
    )
    return figures


def main(arguments: Sequence[str] | None = None) -> int:
    """Command line of the demo."""
    parser = argparse.ArgumentParser(prog="infomap demo-bag", description=__doc__.split("\n")[0])
    parser.add_argument("--bag", type=Path, help=f"default: the shipped {BAG}")
    parser.add_argument("--out", type=Path, default=Path("out/demo-bag"))
    parser.add_argument("--voxel-size", type=float, default=0.05, help="[m]")
    options = parser.parse_args(arguments)

    def run(console: Console) -> dict[str, object]:
        return run_demo(options.bag or find_share(BAG), options.out, options.voxel_size, console)

    return run_demo_command("demo-bag", options.out, run)


if __name__ == "__main__":
    raise SystemExit(main())
