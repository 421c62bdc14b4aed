"""Soak: a bag in a loop through the live chain; memory must stay flat and nothing be lost.

Prints one JSON line a minute and a last one with the verdict; exits with 1 when memory of a node
grew by more than the map's own growth and 5 %, or when data were dropped. The first five minutes,
in which map and caches fill, do not count.

    python benchmarks/soak.py [--minutes 60] [--rate 1.0]
"""

from __future__ import annotations

import argparse
import json
import tempfile
import time
from pathlib import Path

from stereo_bag import write_stereo_bag

from infomap_ros.nodes.live_run import LiveRun

SETTLING = 300.0  # [s]
ALLOWED_GROWTH = 1.05


def memory_of(pid: int) -> int:
    """Memory of a process that it shares with no other [bytes]."""
    lines = Path(f"/proc/{pid}/smaps_rollup").read_text().splitlines()
    kilobytes = sum(int(line.split()[1]) for line in lines if line.startswith("Private_"))
    return 1024 * kilobytes


def soak(bag: Path, seconds: float, rate: float, interval: float) -> dict[str, object]:
    """Run and report; the last report is the verdict."""
    player = {"rate": rate, "loop": True}
    with tempfile.TemporaryDirectory() as folder, LiveRun(bag, Path(folder), player) as run:
        run.start()
        run.spin_until(lambda: run.state.count("map_fusion") > 0, "the first scan", 180.0)
        settling = min(SETTLING, seconds / 2.0)
        begin = time.monotonic()
        before: dict[str, int] = {}
        while time.monotonic() < begin + seconds:
            run.spin_for(interval)
            report = report_of(run, time.monotonic() - begin)
            print(json.dumps(report), flush=True)
            if not before and time.monotonic() >= begin + settling:
                before = {name: memory_of(pid) for name, pid in run.pids.items()}
                map_before = run.state.count("map_fusion", "map memory [bytes]")
        after = {name: memory_of(pid) for name, pid in run.pids.items()}
        grown = run.state.count("map_fusion", "map memory [bytes]") - map_before
        return verdict(before, after, grown, run)


def report_of(run: LiveRun, elapsed: float) -> dict[str, object]:
    memory = {name: round(memory_of(pid) / 1e6, 1) for name, pid in run.pids.items()}
    return {
        "elapsed_s": round(elapsed),
        "scans": run.state.count("map_fusion"),
        "drops": run.state.drops(),
        "map_mb": round(run.state.count("map_fusion", "map memory [bytes]") / 1e6, 1),
        "memory_mb": memory,
    }


def verdict(
    before: dict[str, int], after: dict[str, int], map_growth: int, run: LiveRun
) -> dict[str, object]:
    """What has become of memory and data."""
    growth = {}
    for name, amount in after.items():
        own = map_growth if name == "map_fusion" else 0
        growth[name] = round((amount - own) / before[name], 3)
    measured, fused = run.state.count("stereo_range"), run.state.count("map_fusion")
    flat = all(value <= ALLOWED_GROWTH for value in growth.values())
    return {
        "benchmark": "soak",
        "flat": flat,
        "growth": growth,
        "pairs_measured": measured,
        "pairs_fused": fused,
        "drops": run.state.drops(),
        "passed": flat and not run.state.drops(),
    }


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--minutes", type=float, default=60.0)
    parser.add_argument("--rate", type=float, default=1.0)
    parser.add_argument("--frames", type=int, default=60)
    parser.add_argument("--interval", type=float, default=60.0, help="between two reports [s]")
    parser.add_argument("--bag", type=Path, help="where the bag is kept between runs")
    options = parser.parse_args()
    bag = options.bag or Path("out/bench") / f"room_{options.frames}"
    bag.parent.mkdir(parents=True, exist_ok=True)
    write_stereo_bag(bag, options.frames)
    result = soak(bag, 60.0 * options.minutes, options.rate, options.interval)
    print(json.dumps(result))
    return 0 if result["passed"] else 1


if __name__ == "__main__":
    raise SystemExit(main())
