"""Soak: a bag in a loop through the live chain; memory must stay flat and nothing be lost.

At the end the player is stopped, and every pair that it played must be in the map; a listener in a
process of its own counts them too. Prints one JSON line a minute and a last one with the
verdict; exits with 1 when memory of a node grew by more than the map's own growth and 5 %, or when
pairs were lost. The first five minutes, in which map and caches fill, do not count for memory.

map_fusion makes memory ready at the start for as many clouds as its queues hold, so that it takes
no more when they wait. What a node would leak could hide in it; so what is in use of the heap is
told and judged too, by the least of a quarter of the run, when no cloud waits. The publisher of the
clouds keeps memory of as many as it ever had to keep at once for its subscriber, at the most as
many as it is deep (`publisher_memory.py`); whole clouds up to that number do not count as growth.

    python benchmarks/soak.py [--minutes 60] [--rate 1.0]
"""

from __future__ import annotations

import argparse
import json
import tempfile
import time
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
from sensor_msgs.msg import Image
from stereo_bag import write_stereo_bag

from infomap_ros.nodes.live.bag_demo import LEFT, LiveRun

SETTLING = 300.0  # [s]
ALLOWED_GROWTH = 1.05
QUEUE = 50  # a machine that is busy with other things is not a loss
CLOUD = 12.3  # [MB], of 640x480 points with covariances
KEPT_CLOUDS = 5  # depth of the publisher of points2


class Soak:
    """A run that is measured.

    Args:
        run: not yet started.
    """

    def __init__(self, run: LiveRun) -> None:
        self._run = run
        self._played: Counter[str] = Counter()
        self._samples: list[dict[str, float]] = []
        run.subscribe(Image, LEFT, self._on_image)

    def _on_image(self, _: Any) -> None:
        self._played[LEFT] += 1

    def measure(self, seconds: float, interval: float) -> dict[str, object]:
        """Run and report; returns the verdict."""
        run = self._run
        run.start()
        run.spin_until(lambda: run.state.count("map_fusion") > 0, "the first scan", 180.0)
        begin = time.monotonic()
        while time.monotonic() < begin + seconds:
            run.spin_for(interval)
            self._samples.append(self._sample(time.monotonic() - begin))
            print(json.dumps(self._samples[-1] | {"drops": run.state.drops()}), flush=True)
        run.stop_player()
        run.spin_until(lambda: run.settled, "the last scan", 60.0)
        return self._verdict(min(SETTLING, seconds / 2.0))

    def _sample(self, elapsed: float) -> dict[str, float]:
        state = self._run.state
        sample = {
            "elapsed_s": round(elapsed),
            "received": self._played[LEFT],
            "fused": state.count("map_fusion"),
            "map_mb": round(state.count("map_fusion", "map memory [bytes]") / 1e6, 1),
        }
        for name in ("map_fusion", "stereo_range"):
            in_use = state.count(name, "heap in use [bytes]")
            sample[f"{name}_in_use_mb"] = round(in_use / 1e6, 1)
            sample[f"{name}_most_waiting"] = state.count(name, "most jobs waiting")
        memory = {name: round(memory_of(pid) / 1e6, 1) for name, pid in self._run.pids.items()}
        return sample | {f"{name}_mb": amount for name, amount in memory.items()}

    def _verdict(self, settling: float) -> dict[str, object]:
        """What has become of memory and data."""
        counted = [sample for sample in self._samples if sample["elapsed_s"] >= settling]
        growth = {name: growth_of(counted, name) for name in self._run.pids}
        growth_in_use = {n: growth_in_use_of(counted, n) for n in ("map_fusion", "stereo_range")}
        state = self._run.state
        pairs = {
            "received": state.count("stereo_range", f"/{LEFT} count"),
            "measured": state.count("stereo_range"),
            "clouds": state.count("map_fusion", "/points2 count"),
            "fused": state.count("map_fusion"),
        }
        received = self._played[LEFT]  # the listener may be discovered after the first pairs
        kept = len(set(pairs.values())) == 1 and received <= pairs["fused"] < received + 10
        ratios = [*growth.values(), *growth_in_use.values()]
        flat = all(value <= ALLOWED_GROWTH for value in ratios)
        return {
            "benchmark": "soak",
            "minutes": round(self._samples[-1]["elapsed_s"] / 60.0, 1),
            "flat": flat,
            "growth": growth,
            "growth_in_use": growth_in_use,
            "received": received,
            **pairs,
            "drops": state.drops(),
            "passed": flat and kept and not state.drops(),
        }


def growth_of(samples: list[dict[str, float]], name: str) -> float:
    """Memory at the end over that at the begin, without what the map itself grew.

    Each is the median of a quarter of the samples.
    """
    begin, end = first_and_last_quarter(samples, name, "mb")
    return round(float(np.median(end) / np.median(begin)), 3)


def growth_in_use_of(samples: list[dict[str, float]], name: str) -> float:
    """The same of what is in use of the heap, each the least of a quarter of the samples.

    Without the whole clouds that the publisher of stereo_range may keep.
    """
    begin, end = first_and_last_quarter(samples, name, "in_use_mb")
    most = KEPT_CLOUDS if name == "stereo_range" else 0
    kept = min(max(round((min(end) - min(begin)) / CLOUD), 0), most)
    return round((min(end) - kept * CLOUD) / min(begin), 3)


def first_and_last_quarter(
    samples: list[dict[str, float]], name: str, figure: str
) -> tuple[list[float], list[float]]:
    """A node's memory without the map [MB], of the first and of the last samples."""
    of_map = "map_mb" if name == "map_fusion" else None
    amounts = [s[f"{name}_{figure}"] - (s[of_map] if of_map else 0.0) for s in samples]
    quarter = max(1, len(amounts) // 4)
    return amounts[:quarter], amounts[-quarter:]


def memory_of(pid: int) -> int:
    """Memory of a process that it shares with no other [bytes]."""
    lines = Path(f"/proc/{pid}/smaps_rollup").read_text().splitlines()
    kilobytes = sum(int(line.split()[1]) for line in lines if line.startswith("Private_"))
    return 1024 * kilobytes


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
    player = {"rate": options.rate, "loop": True}
    queues = {"queue_size": QUEUE}
    fusion = queues | {"reserved_memory": (QUEUE + 10) * CLOUD}
    with (
        tempfile.TemporaryDirectory() as folder,
        LiveRun(bag, Path(folder), player, stereo=queues, fusion=fusion) as run,
    ):
        result = Soak(run).measure(60.0 * options.minutes, options.interval)
    print(json.dumps(result))
    return 0 if result["passed"] else 1


if __name__ == "__main__":
    raise SystemExit(main())
