"""How well the rover explores seeded worlds: coverage, contacts, errors, why it ended.

The rover localizes by its own images, odometry and joints; its map's frame is that of the board of
tags near the start. `--set robot.pose_source=simulator` gives it the true pose with a little noise.
Coverage is measured against the true surface that can be seen from reachable views, errors of poses
and map against the truth in the target's frame. One JSON line per world, then a table; `--le` adds
what was predicted of the localization error, and what came of it. Takes minutes per world; `--jobs`
runs several at once. With `--out` what is there is not run again, so that a series can be broken
off and go on, and a command with `--table` shows what there is.

    python benchmarks/exploration_worlds.py --worlds mars office cave --seeds 4 --jobs 2 --out DIR
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import sys
import tempfile
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np

from infomap_ros.cli.settings import with_settings
from infomap_ros.geometry.atomic_file import write_json
from infomap_ros.simulation.exploring.exploration_run import ExplorationOptions, ExplorationRun

ROW_FILE = "row.json"


def kept_or_new(name: str, seed: int, out: Path, settings: list[str]) -> dict[str, Any]:
    """The figures of a world that was explored before, else those of exploring it now."""
    kept = out / f"{name}_{seed}" / ROW_FILE
    if kept.is_file():
        row: dict[str, Any] = json.loads(kept.read_text(encoding="utf-8"))
        return row
    row = explore(name, seed, out, settings) | {"settings": settings}
    write_json(kept, row)
    return row


def explore(name: str, seed: int, out: Path, settings: list[str]) -> dict[str, Any]:
    """Explore one world; map and poses are compared with the truth."""
    given = [f"world.name={name}", f"world.seed={seed}", *settings]
    options = with_settings(ExplorationOptions(), given)
    run = ExplorationRun(options, out / f"{name}_{seed}")
    figures = run.write_results(run.run())
    run.close()
    return figures | {
        "predictions": [dataclasses.astuple(each) for each in run.audit.predictions],
        "scan_nees": [round(each.nees, 2) for each in run.audit.poses],
        "scan_errors": [round(float(np.linalg.norm(e.error[:3])), 5) for e in run.audit.poses],
        "touched": [dataclasses.astuple(contact) for contact in run.simulator.contact_events],
    }


def print_table(rows: list[dict[str, Any]]) -> None:
    """One row per world."""
    print(
        "| world | end | views | way | true coverage | contacts | pose error at the end, rms "
        "| pose NEES / 6 | map within 1 / 2 / 3 sigma | time |"
    )
    print("|" + " --- |" * 10)
    for row in rows:
        nan = float("nan")
        within = " / ".join(f"{100 * row[f'within_{n}_sigma']:.0f}" for n in (1, 2, 3))
        print(
            f"| {row['world']} {row['seed']} | {row['end']} | {row['views']} | {row['distance']} m "
            f"| {100 * row['true_coverage']:.1f} % | {row['contacts']} "
            f"| {1e3 * row.get('pose_error_end', nan):.0f} mm, "
            f"{1e3 * row.get('pose_error_rms', nan):.0f} mm "
            f"| {row['pose_nees']:.2f} | {within} % | {row['seconds']:.0f} s |"
        )


def print_predictions(rows: list[dict[str, Any]]) -> None:
    """Position sigmas on arrival: as predicted, as claimed then, and the true errors."""
    print("| world | views | predicted | claimed | ratio, middle half | true error, rms |")
    print("|" + " --- |" * 6)
    for row in rows:
        if not row["predictions"]:
            continue
        _, predicted, claimed, error = np.array(row["predictions"]).T
        low, high = np.quantile(claimed / predicted, (0.25, 0.75))
        print(
            f"| {row['world']} {row['seed']} | {len(error)} | {1e3 * predicted.mean():.1f} mm "
            f"| {1e3 * claimed.mean():.1f} mm | {low:.2f} to {high:.2f} "
            f"| {1e3 * np.sqrt(np.mean(error**2)):.1f} mm |"
        )


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--worlds", nargs="+", default=["mars", "office", "cave"])
    parser.add_argument("--seeds", type=int, default=4, help="seeds 1 to this, per world")
    parser.add_argument("--first", type=int, default=1, help="first seed")
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--out", type=Path, default=None, help="keep maps, logs and reports here")
    parser.add_argument("--table", action="store_true", help="run nothing, show what is kept")
    parser.add_argument("--le", action="store_true", help="compare predicted errors with real ones")
    parser.add_argument("--set", action="append", default=[], dest="settings")
    options = parser.parse_args()
    out = options.out or Path(tempfile.mkdtemp())
    tasks = [
        (name, seed)
        for seed in range(options.first, options.first + options.seeds)
        for name in options.worlds
    ]
    if options.table:
        tasks = [task for task in tasks if (out / "{}_{}".format(*task) / ROW_FILE).is_file()]
    rows = []
    with ProcessPoolExecutor(options.jobs) as pool:
        jobs = [pool.submit(kept_or_new, *task, out, options.settings) for task in tasks]
        for job in jobs:
            rows.append(job.result())
            print(json.dumps(rows[-1]), flush=True)
    print_table(rows)
    if options.le:
        print_predictions(rows)
    return 0


if __name__ == "__main__":
    sys.exit(main())
