"""How well the rover explores seeded worlds: coverage, contacts, errors, why it ended.

Coverage is measured against the true surface that can be seen from reachable views, errors against
the true surface. One JSON line per world, then a table. Takes minutes per world; `--jobs` runs
several at once.

    python benchmarks/exploration_worlds.py --worlds mars office cave --seeds 4 --jobs 2
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any

from infomap_ros.replay.settings import with_settings
from infomap_ros.simulation.exploration_run import ExplorationOptions, ExplorationRun
from infomap_ros.simulation.visible_surface import map_errors, surface_coverage, visible_surface


def explore(name: str, seed: int, out: Path, settings: list[str]) -> dict[str, Any]:
    """Explore one world and compare the map with the truth."""
    given = [f"world.name={name}", f"world.seed={seed}", *settings]
    options = with_settings(ExplorationOptions(), given)
    run = ExplorationRun(options, out / f"{name}_{seed}")
    figures = run.write_results(run.run())
    world = run.simulator.world
    visible = visible_surface(world, options.planner.max_range)
    errors = map_errors(run.map, world)
    run.close()
    return figures | {
        "coverage": round(surface_coverage(run.map, visible.points), 4),
        "within_1_sigma": round(errors.share_within(1.0), 4),
        "within_3_sigma": round(errors.share_within(3.0), 4),
        "rms_sigmas": round(errors.root_mean_square, 3),
        "touched": sorted({f"{c.link} {c.other}" for c in run.simulator.contact_events}),
    }


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--worlds", nargs="+", default=["mars", "office", "cave"])
    parser.add_argument("--seeds", type=int, default=4, help="seeds 1 to this, per world")
    parser.add_argument("--first", type=int, default=1, help="first seed")
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--out", type=Path, default=None, help="keep maps, logs and reports here")
    parser.add_argument("--set", action="append", default=[], dest="settings")
    options = parser.parse_args()
    out = options.out or Path(tempfile.mkdtemp())
    tasks = [
        (name, seed)
        for seed in range(options.first, options.first + options.seeds)
        for name in options.worlds
    ]
    rows = []
    with ProcessPoolExecutor(options.jobs) as pool:
        jobs = [pool.submit(explore, *task, out, options.settings) for task in tasks]
        for job in jobs:
            rows.append(job.result())
            print(json.dumps(rows[-1]), flush=True)
    print("| world | end | views | way | coverage | contacts | within 1 / 3 sigma | time |")
    print("| --- | --- | --- | --- | --- | --- | --- | --- |")
    for row in rows:
        print(
            f"| {row['world']} {row['seed']} | {row['end']} | {row['views']} | {row['distance']} m "
            f"| {100 * row['coverage']:.1f} % | {row['contacts']} "
            f"| {100 * row['within_1_sigma']:.0f} / {100 * row['within_3_sigma']:.0f} % "
            f"| {row['seconds']:.0f} s |"
        )
    return 0


if __name__ == "__main__":
    sys.exit(main())
