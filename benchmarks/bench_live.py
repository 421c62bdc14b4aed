"""Live chain: 640x480 pairs at 10 Hz from bag_player through stereo_range and map_fusion.

Prints one JSON line: dropped pairs and the delay from the arrival of an image to the arrival of the
last map update of its stamp, both at a listener in a process of its own. Whether the machine had
cores to give is told beside it (`machine.py`). With --keep-scans there is somebody who could
correct poses, so that map_fusion keeps its scans.

    python benchmarks/bench_live.py [--frames 60] [--rate 1.0] [--voxel-size 0.05] [--keep-scans]
"""

from __future__ import annotations

import argparse
import json
import os
import tempfile
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from machine import Machine, cpu_seconds
from nav_msgs.msg import Path as PoseList
from stereo_bag import write_stereo_bag

from infomap_ros.nodes.live.bag_demo import LiveRun
from infomap_ros.nodes.live.live_graph import RunState

WARM_UP = 5  # pairs that are not counted: discovery and first use of memory


def measure(
    bag: Path, frames: int, rate: float, voxel_size: float, keep_scans: bool
) -> dict[str, object]:
    """Play the bag once and collect the figures."""
    fusion = {"voxel_size": voxel_size}
    with (
        tempfile.TemporaryDirectory() as folder,
        LiveRun(bag, Path(folder), {"rate": rate}, fusion=fusion) as run,
    ):
        run.watch_updates()
        run.watch_images()
        if keep_scans:
            run.publisher(PoseList, "keyframe_poses")
        run.start()
        run.spin_until(lambda: bool(run.state.updates), "the first update", 60.0)
        nodes = {name: run.pids[name] for name in ("stereo_range", "map_fusion")}
        before = {name: cpu_seconds(pid) for name, pid in nodes.items()}
        with Machine(nodes) as machine:
            run.spin_until(lambda: run.played, "the end of the bag", 60.0 + frames / (10.0 * rate))
            outside = machine.figures()
            run.spin_until(lambda: run.settled, "the last scan", 30.0)
        used = {n: 1e3 * (cpu_seconds(pid) - before[n]) / frames for n, pid in nodes.items()}
        result = figures(run.state, frames, rate, voxel_size)
        kept = {"scans_kept": keep_scans, "cpu_ms_per_pair": used, "machine": outside}
        return result | kept


def figures(state: RunState, frames: int, rate: float, voxel_size: float) -> dict[str, object]:
    """The JSON line."""
    stamps = sorted(state.images.keys() & state.updates.keys())[WARM_UP:]
    delays = np.array([state.updates[stamp] - state.images[stamp] for stamp in stamps])
    return {
        "benchmark": "live",
        "pairs": frames,
        "pair_rate_hz": 10.0 * rate,
        "voxel_size": voxel_size,
        "cores": os.cpu_count(),
        "load_before": round(os.getloadavg()[0], 2),
        "clouds_received": state.count("map_fusion", "/points2 count"),
        "updates_seen": len(state.updates),
        "pairs_measured": state.count("stereo_range"),
        "pairs_fused": state.count("map_fusion"),
        "pairs_dropped": frames - state.count("map_fusion"),
        "drops": state.drops(),
        "delay_median_ms": round(1e3 * float(np.median(delays)), 1),
        "delay_95_ms": round(1e3 * float(np.percentile(delays, 95)), 1),
        "delay_max_ms": round(1e3 * float(delays.max()), 1),
    }


def rounded(values: Mapping[str, object]) -> dict[str, object]:
    """The same with two digits after the point."""
    return {
        name: rounded(value)
        if isinstance(value, Mapping)
        else (round(value, 2) if isinstance(value, float) else value)
        for name, value in values.items()
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--frames", type=int, default=60)
    parser.add_argument("--rate", type=float, default=1.0)
    parser.add_argument("--voxel-size", type=float, default=0.05)
    parser.add_argument("--keep-scans", action="store_true")
    parser.add_argument("--bag", type=Path, help="where the bag is kept between runs")
    options = parser.parse_args()
    bag = options.bag or Path("out/bench") / f"room_{options.frames}"
    bag.parent.mkdir(parents=True, exist_ok=True)
    write_stereo_bag(bag, options.frames)
    settings = options.frames, options.rate, options.voxel_size, options.keep_scans
    result = measure(bag, *settings)
    print(json.dumps(rounded(result)))


if __name__ == "__main__":
    main()
