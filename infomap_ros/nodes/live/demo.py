"""``make demo``: a simulated rover explores a rough world, a process for each node.

Leaves the map file, the map as .ply, a picture, the log of the run, summary.json and a
self-contained report.html in the output folder, and the logs of the nodes below ``log/``. At its
end map and poses are compared with what only the simulator knows. Exits with 1 and one clear line
when it could not.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from rich.console import Console
from rich.status import Status

from infomap_ros.exploration.records.recorded_run import read_run
from infomap_ros.exploration.records.run_figures import hindrance_figures, prediction_figures
from infomap_ros.exploration.reports.report import write_report
from infomap_ros.mapping import VoxelMap
from infomap_ros.mapping.files.export import write_ply
from infomap_ros.mapping.files.pictures import draw_map_views
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
from infomap_ros.nodes.live.kernels import PLANNING, SENSING, KernelProcess, compile_kernels
from infomap_ros.nodes.live.live_exploration import LiveExploration
from infomap_ros.nodes.live.live_truth import LiveTruth, compare_with_truth, live_map_frame
from infomap_ros.nodes.simulated.simulated_driver import simulated_driver
from infomap_ros.replay.map_files import MAP_FILE, PLY_FILE
from infomap_ros.simulation.exploring.truth import pose_errors
from infomap_ros.simulation.robots.robot_file import RobotFile
from infomap_ros.simulation.worlds.builder import World

PICTURE_FILE = "map.png"
_COMPILING = 1800.0  # [s] that kernels may take on a slow machine
_STOPPING = 60.0  # [s] that an exploration may take to end that was stopped


@dataclass(frozen=True)
class DemoConfig:
    """What is explored, and how far.

    Attributes:
        world: mars, office or cave.
        seed: of the world.
        size: of the world [m]; 0 for its usual size.
        max_views: after which the exploration ends.
        known_fraction: of the reachable surface that the robot must know precisely.
        voxel_size: [m].
        strategy: that chooses views.
        robot: its file, or the name of one of ``config/robots``; the rover where empty.
        timeout: [s].
        lockstep: simulated time waits for the nodes, so that the run does not depend on the
            machine; else they think while it passes.
    """

    world: str = "mars"
    seed: int = 1
    size: float = 5.5
    max_views: int = 60
    known_fraction: float = 0.9
    voxel_size: float = 0.05
    strategy: str = "largest_information"
    robot: str = ""
    timeout: float = 3600.0
    lockstep: bool = False


def run_demo(config: DemoConfig, out: Path, console: Console) -> dict[str, object]:
    """Explore, compare with the truth and write everything.

    Args:
        config: what is explored.
        out: folder for the results; what was in it is gone.
        console: for the progress.

    Returns:
        Figures of the run, flat.

    Raises:
        InfomapError: it could not be done; says why.
        KeyboardInterrupt: it was; once the robot explores, all is written before.
    """
    empty_folder(out)
    world = demo_world(config.world, config.seed, config.size)
    start = time.monotonic()
    status, parameters = Status(status_line({}), console=console), _parameters(config, world)
    with status:
        with LiveExploration(out, parameters, lockstep=config.lockstep) as run:
            say_page(run.open_own_page(), console)
            observed, picture = LiveTruth(run), FirstPicture(run.map_file, out / PICTURE_FILE)
            _start(run, picture, status, console)
            interrupted = follow_to_the_end(run, status, console, config.timeout)
            console.print(run.call("map_fusion/save"), highlight=False)
            results: dict[str, object] = {"world": config.world, "seed": config.seed}
            results |= robot_results(run.figures) | drop_results(run.state)
        results["seconds_to_first_picture"] = picture.seconds
        results["simulated_seconds"] = round(observed.simulated_seconds, 1)
        results["seconds"] = round(time.monotonic() - start, 1)
        status.update("comparing map and poses with the truth")
        voxel_map = VoxelMap.load(out / MAP_FILE)
        poses = observed.poses(live_map_frame(world))
        truth = compare_with_truth(world, voxel_map, [observed])
        results |= {"poses": len(poses), **pose_errors(poses), **truth.figures()}
        write_results(out, voxel_map, results)
    console.print(truth.summary(), highlight=False)
    if interrupted:
        raise KeyboardInterrupt
    return results


def follow_to_the_end(
    run: LiveExploration, status: Status, console: Console, timeout: float
) -> bool:
    """Watch an exploration to its end; whether Ctrl-C has brought that about.

    Raises:
        KeyboardInterrupt: Ctrl-C again.
        ProcessError: a node failed, or it takes longer than `timeout` [s].
    """

    def show() -> None:
        status.update(status_line(run.figures))

    try:
        run.follow(show, timeout)
    except KeyboardInterrupt:
        console.print("stopping; map and report follow")
        run.call("explorer/stop")
        run.follow(show, _STOPPING)
        return True
    return False


class FirstPicture:
    """Draws the map as soon as it has a surface, so that there is something to look at.

    Args:
        map_file: that map_fusion saves from time to time.
        path: PNG file to write.

    Attributes:
        seconds: from when this was made until it was drawn; None before.
    """

    def __init__(self, map_file: Path, path: Path) -> None:
        self._map_file, self._path, self._begin = map_file, path, time.monotonic()
        self._tried = 0
        self.seconds: float | None = None

    def draw(self) -> bool:
        """Draw if there is a new map and none was drawn before; whether it was drawn now.

        Raises:
            MapFileError: the map file cannot be used.
            OSError: the picture cannot be written.
        """
        if self.seconds is not None or not self._map_file.is_file():
            return False
        saved = self._map_file.stat().st_mtime_ns
        if saved == self._tried:
            return False
        self._tried = saved
        voxel_map = VoxelMap.load(self._map_file)
        if not voxel_map.surface_voxels:
            return False
        draw_map_views(voxel_map, self._path)
        self.seconds = round(time.monotonic() - self._begin, 1)
        return True


def _start(run: LiveExploration, picture: FirstPicture, status: Status, console: Console) -> None:
    """Start the nodes as soon as their kernels are compiled: those that map before the others."""

    def show() -> None:
        if picture.draw():
            console.print(f"first picture of the map after {picture.seconds} s", highlight=False)

    compile_kernels(
        lambda stage: status.update(f"compiling kernels, minutes the first time: {stage}"), SENSING
    )
    run.start_sensing()
    status.update("the robot maps what it sees, while the kernels of planning are compiled")
    with KernelProcess(PLANNING) as planning:
        run.spin_until(lambda: planning.done, "the kernels of planning", _COMPILING, show)
    run.start_planning()
    run.spin_until(lambda: picture.seconds is not None, "the first map", _COMPILING, show)


def _parameters(config: DemoConfig, world: World) -> dict[str, dict[str, object]]:
    limits = {"max_views": config.max_views, "known_fraction": config.known_fraction}
    task = task_parameters(world, limits)
    robot = RobotFile.read(config.robot).parameters if config.robot else {}
    return {
        "/**": robot,
        "robot_driver": simulated_driver(config.robot),
        "simulator": {
            "world": config.world,
            "world_seed": config.seed,
            "world_size": config.size,
        },
        "map_fusion": {"voxel_size": config.voxel_size},
        "next_best_view": {"strategy": config.strategy, **task},
        "explorer": task,
    }


def write_results(out: Path, voxel_map: VoxelMap, results: dict[str, object]) -> None:
    """Write .ply, picture, summary and report from the map and the log of the run."""
    write_ply(voxel_map, out / PLY_FILE)
    draw_map_views(voxel_map, out / PICTURE_FILE)
    run = read_run(out / "exploration.jsonl")
    results |= {
        "known_voxels": voxel_map.known_voxels,
        "surface_voxels": voxel_map.surface_voxels,
        "memory_bytes": voxel_map.memory_bytes(),
        "voxel_size": voxel_map.config.voxel_size,
        **prediction_figures(run),
        **hindrance_figures(run),
    }
    write_summary(out, results)
    write_report(
        out / REPORT_FILE,
        out / "exploration.jsonl",
        voxel_map,
        f"Exploring {results['world']}, seed {results['seed']}",
        "A simulated robot with an arm and a stereo pair, each node a process of its own.",
        results,
    )


def main(arguments: Sequence[str] | None = None) -> int:
    """Command line of the demo."""
    about, usual = __doc__.split("\n")[0], DemoConfig()
    parser = exploration_parser(
        "demo", about, "out/demo", usual.max_views, usual.voxel_size, usual.size
    )
    parser.add_argument("--strategy", default=usual.strategy, help="that chooses views")
    parser.add_argument("--robot", default="", help="its file, or tiago, stretch and so on")
    parser.add_argument("--lockstep", action="store_true", help="simulated time waits for nodes")
    parser.add_argument("--timeout", type=float, default=usual.timeout, help="[s]")
    options = vars(parser.parse_args(arguments))
    out = options.pop("out")

    def run(console: Console) -> dict[str, object]:
        results = run_demo(DemoConfig(**options), out, console)
        check_not_failed(results, out)
        return results

    return run_demo_command("demo", out, run)


if __name__ == "__main__":
    raise SystemExit(main())
