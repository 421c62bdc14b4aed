"""Does a team map faster than one robot? Views, meters and time to a coverage, world by world.

Each world is explored by one rover and by a team, until the map of a robot has the asked share of
the true surface that reachable views can see. In the team, a share of all packets is lost, and the
last robot's software is ended without warning midway and started again 20 s later from its files.
Poses are the truth with a noise of 3 mm and 2.6 mrad; with `--localized`, each robot has its own
from its images, odometry and joints, and what all share is the board of tags near the start. One
JSON line for each run, then a table, then one JSON line for all. Runs that are in the output folder
are not made again.

    python benchmarks/team_worlds.py --worlds mars cave office --seeds 4 --out out/team_worlds
"""

from __future__ import annotations

import argparse
import json
import shutil
import sys
from pathlib import Path
from typing import Any

import numpy as np

from infomap_ros.cli.command_options import with_settings
from infomap_ros.geometry.atomic_file import write_text
from infomap_ros.studies.team.team_exploration import TeamExploration
from infomap_ros.studies.team.team_robot import TeamExplorationOptions

_ALWAYS = ("planner.threads=1",)


def explore(name: str, seed: int, robots: int, out: Path, settings: list[str]) -> dict[str, Any]:
    """One run, or its result from the folder."""
    kept = out / f"{name}_{seed}_{robots}.json"
    asked = [f"world.name={name}", f"world.seed={seed}", f"team.robots={robots}"]
    given = [*asked, *_ALWAYS, *settings]
    if robots == 1:
        given.append("team.killed_at=0")
    if kept.exists():
        result: dict[str, Any] = json.loads(kept.read_text())
        if result["settings"] == given:
            return result
    folder = kept.with_suffix("")
    shutil.rmtree(folder, ignore_errors=True)
    exploration = TeamExploration(with_settings(TeamExplorationOptions(), given), folder)
    result = {**exploration.run(), "settings": given}
    result["looks"] = [[look.views, look.distance, look.coverage] for look in exploration.looks]
    write_text(kept, json.dumps(result) + "\n")
    return result


def print_table(pairs: list[tuple[dict[str, Any], dict[str, Any]]]) -> None:
    """One row per world: the robot alone, and each robot of the team."""
    print("| world | coverage | views each | driven by each | time | contacts | same hash, after |")
    print("|" + " --- |" * 7)
    for one, team in pairs:
        agreed = f"yes, {team['agreed_after']} s" if team["same_hash"] else "no"
        both = [
            [
                f"{100 * run['true_coverage']:.1f} %",
                f"{run['views_per_robot']:g}",
                f"{run['distance_per_robot']:.1f} m",
                f"{run['simulated_seconds']:.0f} s",
                f"{run['contacts']}",
            ]
            for run in (one, team)
        ]
        columns = " | ".join(f"{a}, {b}" for a, b in zip(*both, strict=True))
        print(f"| {one['world']} | {columns} | {agreed} |")


def summary(pairs: list[tuple[dict[str, Any], dict[str, Any]]], goal: float) -> dict[str, Any]:
    """Means over the worlds that both have covered, and what must hold in all."""
    both = [pair for pair in pairs if min(run["true_coverage"] for run in pair) >= goal]
    figures: dict[str, Any] = {
        "worlds": len(pairs),
        "covered_by_one": sum(one["true_coverage"] >= goal for one, _ in pairs),
        "covered_by_team": sum(team["true_coverage"] >= goal for _, team in pairs),
        "same_hash": sum(team["same_hash"] for _, team in pairs),
        "restarts": sum(team["kills"] for _, team in pairs),
        "contacts": sum(run["contacts"] for pair in pairs for run in pair),
        "processor_seconds": round(sum(run["processor_seconds"] for p in pairs for run in p)),
    }
    for name in ("views_per_robot", "distance_per_robot", "simulated_seconds"):
        if both:
            ratios = [team[name] / one[name] for one, team in both]
            figures[f"{name}_ratio"] = round(float(np.median(ratios)), 3)
    return figures


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--worlds", nargs="+", default=["mars", "cave", "office"])
    parser.add_argument("--seeds", type=int, default=4, help="seeds 1 to this, per world")
    parser.add_argument("--first", type=int, default=1, help="first seed")
    parser.add_argument("--robots", type=int, default=2, help="of the team")
    parser.add_argument("--coverage", type=float, default=0.9, help="at which a run ends")
    parser.add_argument("--killed-at", type=float, default=0.45, help="coverage; 0: never")
    parser.add_argument("--loss", type=float, default=0.2, help="share of the packets")
    parser.add_argument("--localized", action="store_true", help="no robot is told its pose")
    parser.add_argument("--out", type=Path, default=Path("out/team_worlds"))
    parser.add_argument("--set", action="append", default=[], dest="settings")
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    settings = [
        f"team.coverage={options.coverage}",
        f"team.killed_at={options.killed_at}",
        f"team.loss={options.loss}",
        f"robot.pose_source={'localization' if options.localized else 'simulator'}",
        *options.settings,
    ]
    pairs = []
    for seed in range(options.first, options.first + options.seeds):
        for name in options.worlds:
            runs = [explore(name, seed, n, options.out, settings) for n in (1, options.robots)]
            for run in runs:
                shown = {key: value for key, value in run.items() if key != "looks"}
                print(json.dumps(shown), flush=True)
            pairs.append((runs[0], runs[1]))
    print_table(pairs)
    print(json.dumps(summary(pairs, options.coverage)))
    return 0


if __name__ == "__main__":
    sys.exit(main())
