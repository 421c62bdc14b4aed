"""How well a robot explores seeded worlds by the node graph over DDS, as `make demo` does.

Each world is a run of `infomap_ros.nodes.live.demo`: simulator, localization, range, map, choice
and loop are processes, the world has its usual size, and at the end map and poses are compared with
the truth (docs/results/exploration_worlds.md says what the figures mean). One JSON file per world
in the output folder; a world whose file is there is not run again, so a series that was broken off
goes on where it was. Writes the table into table.md and prints it; `--table` runs nothing.
Simulated time waits for the nodes, so that a row does not depend on the machine; with `--real-time`
they think while time passes. A world takes 10 to 60 minutes of two cores.

    python benchmarks/live_worlds.py --worlds mars:1 office:2 cave:3 --out out/live_worlds
    python benchmarks/live_worlds.py --robot tiago --worlds office:1 --size 7 --out out/live_worlds
"""

from __future__ import annotations

import argparse
import json
import signal
import sys
from pathlib import Path
from typing import Any

from rich.console import Console
from rows import markdown_table, percent, software

from infomap_ros.errors import InfomapError
from infomap_ros.geometry.atomic_file import write_json, write_text
from infomap_ros.nodes.live.demo import DemoConfig, run_demo

TEN_WORLDS = [f"mars:{seed}" for seed in range(1, 5)]
TEN_WORLDS += [f"{name}:{seed}" for name in ("office", "cave") for seed in range(1, 4)]
_COLUMNS = (
    "robot",
    "world, seed",
    "ended, because",
    "views",
    "distance",
    "simulated time",
    "known, as it counts",
    "true coverage",
    "map within 1 / 2 / 3 sigma",
    "pose NEES / 6",
    "contacts",
    "version",
)


def kept_or_new(config: DemoConfig, out: Path, console: Console) -> dict[str, Any]:
    """The figures of a world that was explored before, else those of exploring it now.

    Raises:
        InfomapError: it could not be explored; says why.
    """
    file = row_file(out, config)
    if file.is_file():
        row: dict[str, Any] = json.loads(file.read_text(encoding="utf-8"))
        return row
    row = {
        "software": software(),
        "robot": config.robot,
        **run_demo(config, file.with_suffix(""), console),
    }
    write_json(file, row)
    return row


def row_file(out: Path, config: DemoConfig) -> Path:
    """Where the figures of a world are kept."""
    robot = f"{Path(config.robot).stem}_" if config.robot else ""
    return out / f"{robot}{config.world}_{config.seed}.json"


def table(rows: list[dict[str, Any]]) -> str:
    """A Markdown table with one row per world."""
    return markdown_table(_COLUMNS, map(_cells, rows))


def _cells(row: dict[str, Any]) -> tuple[str, ...]:
    within = " / ".join(percent(row[f"within_{sigmas}_sigma"], 0) for sigmas in (1, 2, 3))
    reason = row["end"] + (f": {row['detail']}" if row["detail"] else "")
    nees = "-" if row["pose_nees"] is None else f"{row['pose_nees']:.2f}"
    return (
        row["robot"] or "rover",
        f"{row['world']} {row['seed']}",
        reason,
        f"{row['views']:.0f}",
        f"{row['distance [m]']:.1f} m",
        f"{row['simulated_seconds']:.0f} s",
        f"{percent(row['known fraction'])} %",
        f"{percent(row['true_coverage'])} %",
        f"{within} %",
        nees,
        str(row["contacts"]),
        row["software"],
    )


def main() -> int:
    signal.signal(signal.SIGTERM, signal.default_int_handler)  # ends the nodes too
    usual = DemoConfig(size=0.0, known_fraction=0.96, max_views=100, timeout=4.0 * 3600.0)
    parser = argparse.ArgumentParser(
        description=__doc__.split("\n")[0], formatter_class=argparse.ArgumentDefaultsHelpFormatter
    )
    parser.add_argument("--worlds", nargs="+", default=TEN_WORLDS, help="name:seed ...")
    parser.add_argument("--robot", default="", help="its file, or tiago, stretch and so on")
    parser.add_argument("--out", type=Path, default=Path("out/live_worlds"))
    parser.add_argument("--table", action="store_true", help="run nothing, show what is there")
    parser.add_argument("--size", type=float, default=usual.size, help="[m]; 0: the usual one")
    parser.add_argument("--max-views", type=int, default=usual.max_views)
    parser.add_argument("--known-fraction", type=float, default=usual.known_fraction)
    parser.add_argument("--voxel-size", type=float, default=usual.voxel_size, help="[m]")
    parser.add_argument("--strategy", default=usual.strategy)
    parser.add_argument("--timeout", type=float, default=usual.timeout, help="of a world [s]")
    parser.add_argument("--real-time", dest="lockstep", action="store_false")
    options = vars(parser.parse_args())
    out, only_table = options.pop("out"), options.pop("table")
    worlds = [name.partition(":")[::2] for name in options.pop("worlds")]
    out.mkdir(parents=True, exist_ok=True)
    rows, failures, console = [], 0, Console(stderr=True)
    for name, seed in worlds:
        config = DemoConfig(world=name, seed=int(seed or 1), **options)
        if only_table and not row_file(out, config).is_file():
            continue
        try:
            rows.append(kept_or_new(config, out, console))
        except (InfomapError, OSError) as error:
            failures += 1
            print(f"{config.world} {config.seed}: {error}", file=sys.stderr)
        write_text(out / "table.md", table(rows))
    print(table(rows), end="")
    return 1 if failures else 0


if __name__ == "__main__":
    sys.exit(main())
