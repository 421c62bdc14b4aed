"""What the demos' command lines have in common: progress, results, and how they end.

What the demos of one robot and of a team have in common, beside their command lines.
"""

from __future__ import annotations

import argparse
import json
import shutil
import signal
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console

from infomap_ros.errors import InfomapError, ProcessError
from infomap_ros.exploration.task import TaskConfig
from infomap_ros.geometry.atomic_file import write_text
from infomap_ros.geometry.transforms import FloatArray
from infomap_ros.nodes.live.live_graph import RunState
from infomap_ros.replay.map_files import SUMMARY_FILE
from infomap_ros.simulation.body.base_motion import level_pose
from infomap_ros.simulation.exploring.exploration_run import task_in
from infomap_ros.simulation.team_world import TeamStart
from infomap_ros.simulation.worlds.builder import World
from infomap_ros.simulation.worlds.scenes import SCENES, make_world, without_target


def _interrupt(number: int, frame: object) -> None:
    raise KeyboardInterrupt


def say_page(address: str, console: Console) -> None:
    """Say where the run can be watched; nothing where there is no page."""
    if address:
        console.print(f"watch it in a browser: {address}", highlight=False, soft_wrap=True)


def run_demo_command(name: str, out: Path, run: Callable[[Console], Mapping[str, object]]) -> int:
    """Run a demo and print its figures as one line of JSON; progress goes to stderr.

    Args:
        name: of the command, for messages.
        out: where it leaves its results.
        run: the demo; given a console for its progress, returns its figures.

    Returns:
        Exit status: 1 with one line where it could not be done, 130 when it was interrupted.
    """
    console = Console(stderr=True)
    signal.signal(signal.SIGTERM, _interrupt)
    try:
        figures = run(console)
    except (InfomapError, OSError) as error:
        print(f"infomap {name}: {error}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print(f"infomap {name}: interrupted", file=sys.stderr)
        return 130
    console.print(f"map, report.html and all else are in {out}")
    print(json.dumps(figures))
    return 0


REPORT_FILE = "report.html"
_STARTING = "starting the nodes; kernels are compiled the first time"


def exploration_parser(
    name: str, description: str, out: str, max_views: int, voxel_size: float, size: float
) -> argparse.ArgumentParser:
    """The command line that both demos have, with the defaults of one of them."""
    parser = argparse.ArgumentParser(
        prog=f"infomap {name}",
        description=description,
        formatter_class=argparse.ArgumentDefaultsHelpFormatter,
    )
    parser.add_argument("--out", type=Path, default=Path(out), help="folder for the results")
    parser.add_argument("--world", default="mars", help="mars, office or cave")
    parser.add_argument("--seed", type=int, default=1, help="of the world")
    parser.add_argument(
        "--size", type=float, default=size, help="of the world [m]; 0 for its usual size"
    )
    parser.add_argument("--max-views", type=int, default=max_views, help="of each rover")
    parser.add_argument(
        "--known-fraction", type=float, default=0.9, help="of the reachable surface, is enough"
    )
    parser.add_argument("--voxel-size", type=float, default=voxel_size, help="[m]")
    return parser


def demo_world(name: str, seed: int, size: float, *, has_board: bool = True) -> World:
    """A world as the node simulator makes it; size 0 for its usual one [m].

    Raises:
        InvalidInputError: there is no such world.
    """
    given: dict[str, Any] = {"size": size} if size else {}
    if not has_board and name in SCENES:
        given |= without_target(name)
    return make_world(name, seed, **given)


def empty_folder(out: Path) -> None:
    """Make a folder for results; what was in it is gone.

    Raises:
        OSError: it cannot be made.
    """
    shutil.rmtree(out, ignore_errors=True)
    out.mkdir(parents=True)


def task_parameters(
    world: World, limits: Mapping[str, object], starts: Sequence[TeamStart] = ()
) -> dict[str, object]:
    """Parameters of nodes that know the task: all of a world, seen from its target.

    Args:
        world: that is to be mapped.
        limits: further fields of `TaskConfig`, by name.
        starts: of a team without a target: the region is that which all of them have about
            themselves, so that it holds in the map of each.
    """
    frames = [world.T_world_target] if not starts else [_on_ground(world, one) for one in starts]
    regions = [task_in(world, TaskConfig(), frame) for frame in frames]
    low = np.min([region.region_low for region in regions], axis=0)
    high = np.max([region.region_high for region in regions], axis=0)
    corners = {"region_low": low.tolist(), "region_high": high.tolist()}
    return {f"task.{name}": value for name, value in {**limits, **corners}.items()}


def _on_ground(world: World, start: TeamStart) -> FloatArray:
    """Pose of a base at its start, about, shape (4, 4)."""
    x, y, yaw = start.place
    level = float(world.terrain.height(np.array([[x, y]]))[0])
    return level_pose((x, y, level), yaw)


def status_line(figures: Mapping[str, str], name: str = "") -> str:
    """What a robot is doing, and how far the map is as it knows it.

    Args:
        figures: of exploration_status; empty before the first one.
        name: of the robot, where there are several.
    """
    robot = f"{name} " if name else ""
    if not figures:
        return f"{robot}{_STARTING}"
    parts = [f"{robot}{figures['state']}", f"{figures['views']} views"]
    parts.append(f"{figures['distance [m]']} m")
    if "known fraction" in figures:
        parts.append(f"{100.0 * float(figures['known fraction']):.1f} % known")
        parts.append(f"mean sigma {1e3 * float(figures['mean sigma [m]']):.1f} mm")
    return ", ".join(parts)


def robot_results(figures: Mapping[str, str], name: str = "") -> dict[str, object]:
    """How the exploration of a robot has ended, flat; arguments as of `status_line`."""
    robot = f"{name} " if name else ""
    results: dict[str, object] = {
        f"{robot}end": figures["state"].removeprefix("ended: "),
        f"{robot}detail": figures["last reason"],
    }
    for figure in ("views", "distance [m]", "known fraction", "mean sigma [m]"):
        known = figures.get(figure)
        results[f"{robot}{figure}"] = None if known is None else float(known)
    return results


def drop_results(state: RunState) -> dict[str, object]:
    """What nodes have dropped, and why, flat."""
    return {f"dropped: {reason}": count for reason, count in sorted(state.drops().items())}


def write_summary(out: Path, results: Mapping[str, object]) -> None:
    """Write the figures of a run beside its results.

    Raises:
        OSError: the file cannot be written.
    """
    write_text(out / SUMMARY_FILE, json.dumps(results, indent=1) + "\n")


def check_not_failed(results: Mapping[str, object], folder: Path, name: str = "") -> None:
    """Make sure that a robot has kept its mission; arguments as of `robot_results`.

    Raises:
        ProcessError: it has failed; names the logs.
    """
    robot = f"{name} " if name else ""
    if results[f"{robot}end"] == "failed":
        where = f"{name}: " if name else ""
        raise ProcessError(f"{where}{results[f'{robot}detail']}; see {folder / 'log'}")
