"""``make demo-bag``: map the shipped bag through the live nodes, four processes over DDS.

Leaves the map file, the map as .ply, pictures, summary.json and report.html in the output folder,
and the logs of the nodes below ``log/``. Exits with 1 and one clear line when it could not.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import Image, PointCloud2

from infomap_ros.errors import BagError, ProcessError
from infomap_ros.exploration.reports.report import write_map_report
from infomap_ros.geometry.atomic_file import write_text
from infomap_ros.geometry.organized import fit_pinhole_camera
from infomap_ros.geometry.resources import find_share
from infomap_ros.mapping import VoxelMap
from infomap_ros.mapping.files.export import surface_vertices, write_ply
from infomap_ros.mapping.files.pictures import draw_map_views
from infomap_ros.messages.rows import decode_rows
from infomap_ros.nodes.common.environment import reliable_inputs
from infomap_ros.nodes.live.demo_command import run_demo_command, say_page
from infomap_ros.nodes.live.live_graph import LiveGraph
from infomap_ros.nodes.live.live_truth import PoseComparison
from infomap_ros.replay.bags.reader import BagReader
from infomap_ros.replay.map_files import (
    MAP_FILE,
    PLY_FILE,
    SUMMARY_FILE,
    draw_depth,
    draw_sigma,
)
from infomap_ros.stereo import PACKED_FIELDS, RangeCloud

# A bag through bag_player, stereo_range and map_fusion, each a process, watched from outside.
#
# With fiducial_localization as a fourth one, where the bag's own poses are not to be used.
#
# The demo, the benchmark of the live chain and the soak test are such runs.

_QUIET = 3.0  # [s]
LEFT, RIGHT = "left/image_raw", "right/image_raw"


class LiveRun(LiveGraph):
    """Node processes that map a bag, and a watcher in this process.

    Args:
        bag: the bag that is played.
        out: folder for the logs.
        player: further parameters of bag_player.
        stereo: further parameters of stereo_range.
        fusion: further parameters of map_fusion.
        map_file: where map_fusion saves; ``map.infomap`` in `out` where not given.
        localization: further parameters of fiducial_localization, which then makes camera_pose
            anew; where not given, the bag's own poses are played.
    """

    may_end = ("bag_player",)

    def __init__(
        self,
        bag: Path,
        out: Path,
        player: Mapping[str, object] | None = None,
        stereo: Mapping[str, object] | None = None,
        fusion: Mapping[str, object] | None = None,
        map_file: Path | None = None,
        localization: Mapping[str, object] | None = None,
    ) -> None:
        super().__init__(out)
        self.map_file = (map_file or out / "map.infomap").absolute()
        pair = [LEFT, RIGHT, "left/camera_info", "right/camera_info"]
        listeners = 1 if localization is None else 2  # of the images
        self._player: dict[str, Any] = {
            "bag": bag.absolute(),
            "wait_for_subscribers": [*pair * listeners, "camera_pose"],
            **(player or {}),
        }
        images = reliable_inputs(pair)
        clouds = reliable_inputs(("points2", "camera_pose", "joint_states"))
        results = reliable_inputs(("map_updates",))
        self._player |= results
        self._stereo = {"rectify": True, **images, **(stereo or {})}
        self._fusion = {"map_file": self.map_file, **clouds, **(fusion or {})}
        self._localization: dict[str, object] | None = None
        if localization is not None:
            self._player |= {"left_out": ["/camera_pose"], "wait_for_publishers": ["camera_pose"]}
            motion = reliable_inputs(("odom", "joint_states"))
            self._localization = {"rectify": True, **images, **motion, **localization}

    def watch_updates(self) -> None:
        """Note when the map updates of each stamp arrive."""
        self._watch("map_updates", PointCloud2, self.state.updates)

    def watch_images(self) -> None:
        """Note when each left image arrives."""
        self._watch(LEFT, Image, self.state.images)

    def watch_clock(self) -> None:
        """Listen to the clock of the bag."""
        self.subscribe(Clock, "/clock", lambda _: None)

    def _watch(self, topic: str, kind: type, arrivals: dict[int, float]) -> None:
        def receive(message: Any) -> None:
            stamp = message.header.stamp
            arrivals[stamp.sec * 1_000_000_000 + stamp.nanosec] = time.monotonic()

        self.subscribe(kind, topic, receive)

    def start(self, timeout: float = 300.0) -> None:
        """Start stereo_range and map_fusion, and when they have found each other the player.

        Args:
            timeout: for the two nodes to be ready [s]; kernels may have to be compiled.

        Raises:
            ProcessError: a node does not start.
        """
        self.start_nodes()
        self.spin_until(self._connected, "stereo_range and map_fusion to connect", timeout)
        self.start_player()

    def start_nodes(self) -> None:
        """Start stereo_range and map_fusion."""
        self.pids["map_fusion"] = self._processes.start("map_fusion", self._fusion)
        self.pids["stereo_range"] = self._processes.start("stereo_range", self._stereo)
        if self._localization is not None:
            name = "fiducial_localization"
            self.pids[name] = self._processes.start(name, self._localization)

    def start_player(self) -> None:
        """Start bag_player; it waits for the nodes, and for this process if it watches images."""
        waits = [*self._player["wait_for_subscribers"], *[LEFT] * self._watched[LEFT]]
        player = self._player | {"wait_for_subscribers": waits}
        self.pids["bag_player"] = self._processes.start("bag_player", player)

    def stop_player(self) -> None:
        """End bag_player before its bag ends, as when it loops.

        Raises:
            ProcessError: it does not end.
        """
        self._processes.end("bag_player")

    def _connected(self) -> bool:
        """Whether the clouds have a listener, and the updates all of this process."""
        clouds = self.state.count("stereo_range", "/points2 subscribers")
        updates = self.state.count("map_fusion", "/map_updates subscribers")
        return clouds >= 1 + self._watched["points2"] and updates >= self._watched["map_updates"]

    @property
    def played(self) -> bool:
        """Whether the bag has been played to its end."""
        return self._processes.status("bag_player") == 0

    @property
    def settled(self) -> bool:
        """Whether the bag has been played and nothing has been fused for a while since."""
        quiet = time.monotonic() - self.state.last_progress
        return self.played and quiet > _QUIET


class LivePictures:
    """Keeps the cloud with the most points that a run has published.

    Args:
        run: the run that is watched.
    """

    def __init__(self, run: LiveRun) -> None:
        self._best: PointCloud2 | None = None
        self._points = 0
        run.subscribe(PointCloud2, "points2", self._on_cloud)

    def _on_cloud(self, message: PointCloud2) -> None:
        z = packed_cloud(message)[::8, ::8, 2]
        points = int(np.isfinite(z).sum())
        if points > self._points:
            self._best, self._points = message, points

    def write(self, out: Path) -> list[tuple[Path, str]]:
        """Write depth.png and sigma.png; returns them with their captions."""
        if self._best is None:
            return []
        packed = packed_cloud(self._best)
        camera = fit_pinhole_camera(packed[..., :3])
        if camera is None:
            return []
        cloud = RangeCloud(camera, packed, packed[..., 2], error_correlation=0.0)
        draw_depth(cloud, out / "depth.png")
        draw_sigma(cloud, out / "sigma.png")
        return [
            (out / "depth.png", "Depth of one pair"),
            (out / "sigma.png", "Its predicted standard deviation"),
        ]


def packed_cloud(message: PointCloud2) -> np.ndarray:
    """The numbers of a cloud of stereo_range, shape (H, W, 10), float32."""
    rows = decode_rows(message)[2]
    return rows.view(np.float32).reshape(message.height, message.width, len(PACKED_FIELDS))


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
