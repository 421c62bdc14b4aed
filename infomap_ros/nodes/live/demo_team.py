"""``make demo-team``: two simulated rovers map one world together, twelve processes over DDS.

A share of what they tell each other is lost, and the second rover's processes are killed midway and
started again. With ``--without-board`` they have no common target: each begins its own map, and
they look for each other by tags on their bodies. Leaves the map of the team as .ply, each robot's
files, summary.json and a self-contained report.html in the output folder. Exits with 1 and one
clear line when something failed, as when the robots do not end with the same map.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Sequence
from pathlib import Path

from rich.console import Console
from rich.status import Status

from infomap_ros.errors import ProcessError
from infomap_ros.exploration.reports.comparison import write_team_report
from infomap_ros.mapping import VoxelMap
from infomap_ros.mapping.files.export import write_ply
from infomap_ros.nodes.live.demo_command import (
    REPORT_FILE,
    check_not_failed,
    demo_world,
    drop_results,
    empty_folder,
    exploration_parser,
    robot_results,
    run_demo_command,
    say_page,
    status_line,
    task_parameters,
    write_summary,
)
from infomap_ros.nodes.live.kernels import TEAM, compile_kernels
from infomap_ros.nodes.live.live_exploration import LOG_FILE, LiveTeam
from infomap_ros.nodes.live.live_truth import LiveTruth, compare_joint_map, compare_with_truth
from infomap_ros.nodes.team.team_map import team_map_file
from infomap_ros.replay.map_files import MAP_FILE, PLY_FILE
from infomap_ros.simulation.exploring.truth import RunTruth
from infomap_ros.simulation.team_world import ABREAST, APART, TeamStart, team_starts
from infomap_ros.simulation.worlds.builder import World

_ROBOTS = 2
_DOWN = 10.0  # [s] until the robot that was killed is started again
_AGREEING = 120.0  # [s]


def run_demo(options: argparse.Namespace, console: Console) -> dict[str, object]:
    """Explore and write everything; returns figures of the run, flat.

    Raises:
        InfomapError: it could not be done; says why.
    """
    out: Path = options.out
    empty_folder(out)
    has_board = not options.without_board
    world = demo_world(options.world, options.seed, options.size, has_board=has_board)
    starts = team_starts(world, _ROBOTS, ABREAST if has_board else APART)
    begin = time.monotonic()
    status = Status("compiling kernels", console=console)
    given = _parameters(options, world, () if has_board else starts)
    run = LiveTeam(out, starts, given, loss=options.loss, has_board=has_board)
    with run, status:

        def show() -> None:
            status.update(" | ".join(status_line(run.figures[n], n) for n in run.names))

        say_page(run.open_team_page(), console)
        compile_kernels(
            lambda step: status.update(f"compiling kernels, minutes the first time: {step}"), TEAM
        )
        ready = time.monotonic() - begin
        console.print(f"kernels are ready after {ready:.0f} s; starting twelve nodes")
        observed = [LiveTruth(run, f"/{name}/") for name in run.names]
        run.start()
        if options.kill_after:
            _kill_and_restart(run, options, console, show)
        run.spin_until(lambda: run.ended, "the explorations to end", options.timeout, show)
        run.stop_looking()
        agreed = run.agree(_AGREEING, show)
        console.print(f"all robots hold the same map: {agreed}", highlight=False)
        for name in run.names:
            run.call(f"/{name}/map_fusion/save")
            run.call(f"/{name}/map_fusion/save_team")
        results = _results(run, options, agreed)
    results |= {"seconds to compile": round(ready, 1)}
    results["seconds"] = round(time.monotonic() - begin, 1)
    truth = _write_results(run, world, observed, options, results)
    console.print(truth.summary(), highlight=False)
    for name, folder in run.folders.items():
        check_not_failed(results, folder, name)
    return results


def _parameters(
    options: argparse.Namespace, world: World, starts: Sequence[TeamStart]
) -> dict[str, dict[str, object]]:
    limits = {"max_views": options.max_views, "known_fraction": options.known_fraction}
    task = task_parameters(world, limits, starts)
    return {
        "simulator": {
            "world": options.world,
            "world_seed": options.seed,
            "world_size": options.size,
            "camera.width": options.width,
            "camera.height": 3 * options.width // 4,
        },
        "map_fusion": {"voxel_size": options.voxel_size},
        "next_best_view": {"threads": 1, **task},
        "explorer": {"planner_timeout": 600.0, **task},
    }


def _kill_and_restart(
    run: LiveTeam, options: argparse.Namespace, console: Console, show: Callable[[], None]
) -> None:
    """Kill all processes of the last robot after some views, and start them again."""
    name, views = run.names[-1], options.kill_after
    run.spin_until(
        lambda: run.views(name) >= views or run.ended, f"{views} views", options.timeout, show
    )
    before = run.views(name)
    run.kill_robot(name)
    console.print(f"{name} was killed after {before} views", highlight=False)
    run.spin_for(_DOWN, show)
    run.figures[name] = {}
    run.start_robot(name)
    run.spin_until(lambda: run.views(name) > 0, f"{name} to be back", options.timeout, show)
    after = run.views(name)
    if after < before:
        raise ProcessError(f"{name} went on after {after} views, but it had taken {before}")
    console.print(f"{name} goes on after {after} views", highlight=False)


def _results(run: LiveTeam, options: argparse.Namespace, agreed: str) -> dict[str, object]:
    results: dict[str, object] = {
        "world": options.world,
        "seed": options.seed,
        "map hash": agreed,
        "lost on purpose": options.loss,
    }
    for name, figures in run.figures.items():
        results |= robot_results(figures, name)
    return results | drop_results(run.state)


def _write_results(
    run: LiveTeam,
    world: World,
    observed: Sequence[LiveTruth],
    options: argparse.Namespace,
    results: dict[str, object],
) -> RunTruth:
    """Write .ply, summary and report from the saved map and the logs; returns the truth."""
    out: Path = options.out
    shared = VoxelMap.load(team_map_file(run.folders[run.names[0]] / MAP_FILE))
    write_ply(shared, out / PLY_FILE)
    if options.without_board:
        truth, met = compare_joint_map(world, shared, observed)
        results |= met
    else:
        truth = compare_with_truth(world, shared, observed)
    results |= truth.figures()
    write_summary(out, results)
    write_team_report(
        out / REPORT_FILE,
        {name: folder / LOG_FILE for name, folder in run.folders.items()},
        shared,
        f"{len(run.names)} rovers explore {options.world}, seed {options.seed}",
        results,
    )
    return truth


def main(arguments: Sequence[str] | None = None) -> int:
    """Command line of the demo."""
    about = __doc__.split("\n")[0]
    parser = exploration_parser(
        "demo-team", about, "out/demo-team", max_views=12, voxel_size=0.06, size=5.0
    )
    parser.add_argument("--width", type=int, default=320, help="of the images [px]")
    parser.add_argument("--loss", type=float, default=0.2, help="share of the team's messages")
    parser.add_argument(
        "--kill-after", type=int, default=3, help="views of the second rover; 0: never"
    )
    parser.add_argument(
        "--without-board",
        action="store_true",
        help="no common target: each rover begins its own map, tags on them join the maps",
    )
    parser.add_argument("--timeout", type=float, default=3600.0, help="[s]")
    options = parser.parse_args(arguments)
    return run_demo_command("demo-team", options.out, lambda console: run_demo(options, console))


if __name__ == "__main__":
    raise SystemExit(main())
