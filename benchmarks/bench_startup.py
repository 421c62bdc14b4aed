"""Start-up: from the start of stereo_range and map_fusion to their first map update.

A bag is already playing; the first start compiles the kernels unless they are in the cache.
Prints one JSON line.

    python benchmarks/bench_startup.py
"""

from __future__ import annotations

import argparse
import json
import os
import tempfile
import time
from pathlib import Path

from stereo_bag import write_stereo_bag

from infomap_ros.nodes.live.bag_demo import LiveRun


def seconds_to_first_update(bag: Path) -> float:
    """Start the nodes beside a playing bag and wait for the first map update [s]."""
    player = {"loop": True, "wait_for_subscribers": ["/clock"]}
    with tempfile.TemporaryDirectory() as folder, LiveRun(bag, Path(folder), player) as run:
        run.watch_updates()
        run.watch_clock()
        run.start_player()
        run.spin_until(lambda: run.state.count("bag_player") > 0, "the player", 60.0)
        start = time.monotonic()
        run.start_nodes()
        run.spin_until(lambda: bool(run.state.updates), "the first update", 300.0)
        return time.monotonic() - start


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--frames", type=int, default=60)
    parser.add_argument("--bag", type=Path, help="where the bag is kept between runs")
    options = parser.parse_args()
    bag = options.bag or Path("out/bench") / f"room_{options.frames}"
    bag.parent.mkdir(parents=True, exist_ok=True)
    write_stereo_bag(bag, options.frames)
    load = os.getloadavg()[0]
    times = [round(seconds_to_first_update(bag), 2) for _ in range(3)]
    figures = {"benchmark": "startup", "cores": os.cpu_count(), "load_before": round(load, 2)}
    print(json.dumps(figures | {"first_start_s": times[0], "warm_starts_s": times[1:]}))


if __name__ == "__main__":
    main()
