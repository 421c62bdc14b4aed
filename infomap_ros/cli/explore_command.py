"""Command ``infomap explore``."""

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Self

import typer
from rich.console import Console
from rich.status import Status

from infomap_ros.cli.command_options import Out, Overwrite, Setting, chosen, lists_settings
from infomap_ros.cli.results import (
    INTERRUPTED,
    Live,
    length,
    live_page,
    results_in,
    say_results,
    says_when_it_compiles,
    stops_when_interrupted,
)
from infomap_ros.cli.study_options import check_strategy
from infomap_ros.errors import ConfigError, ExplorationError, InvalidInputError
from infomap_ros.exploration.loop import EndReason
from infomap_ros.exploration.rules import Request
from infomap_ros.mapping.files.pictures import draw_map_views
from infomap_ros.simulation.exploring.exploration_run import ExplorationOptions, ExplorationRun
from infomap_ros.simulation.robots.robot_file import RobotFile
from infomap_ros.viewer import LivePage
from infomap_ros.viewer.displays import ExplorationDisplay


class RunProgress:
    """One line that says how far the exploration is, and a line for each choice.

    Args:
        console: where to.
    """

    def __init__(self, console: Console) -> None:
        self._console = console
        self._status = Status("preparing world and kernels", console=console)

    def __enter__(self) -> Self:
        self._status.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._status.stop()

    def show(self, entry: Mapping[str, Any]) -> None:
        """Show an entry of the run log."""
        kind = entry["kind"]
        if kind == "progress":
            self._status.update(progress_line(entry))
        elif kind == "decision":
            self._console.print(f"{entry['t']:7.1f} s  {entry['reason']}", highlight=False)
        elif kind == "motion" and entry["outcome"]:
            text = f"{entry['action']}: {entry['outcome']}"
            self._console.print(f"{entry['t']:7.1f} s  {text}", highlight=False)
        elif kind == "end":
            text = f"ended: {entry['reason']}: {entry['detail']}"
            self._console.print(f"{entry['t']:7.1f} s  {text}", highlight=False)


def progress_line(entry: Mapping[str, Any]) -> str:
    """A progress entry in words."""
    sigma = entry["mean_sigma"]
    precision = "" if sigma is None else f", mean sigma {1e3 * sigma:.1f} mm"
    return (
        f"{entry['views']} views, {entry['distance']:.1f} m, "
        f"{100.0 * entry['known_fraction']:.1f} % known, "
        f"{100.0 * entry['precise_fraction']:.1f} % precisely, "
        f"{entry['entropy_bits']:,.0f} bits left{precision}"
    )


Watcher = Callable[[Mapping[str, Any]], None]

_DEFAULTS = ExplorationOptions()
_FILES = {
    "report.html": "the run in a browser: map in 3-D, each choice and its reason",
    "map.png": "the map from above and from the side, and its uncertainty",
    "map.ply": "the surface, for CloudCompare or MeshLab",
    "map.infomap": "the map itself, for infomap show and VoxelMap.load",
    "exploration.jsonl": "the log of the run",
    "summary.json": "the figures of the run",
}


def explore(
    out: Out,
    world: Annotated[
        str,
        typer.Option(
            help="mars, office, cave; a mesh (.stl .obj .dae .ply .glb), a floor plan (.yaml) or "
            "an octree (.bt .ot)"
        ),
    ] = _DEFAULTS.world.name,
    size: Annotated[
        float, typer.Option(help="edge of the world [m]; 0: its usual size")
    ] = _DEFAULTS.world.size,
    robot: Annotated[
        str,
        typer.Option(
            help="file of a robot, as infomap robot writes it, or the name of a ready one: "
            "tiago, tiago_pro, stretch, pr2, ur5_on_base, panda_on_base",
            show_default="the rover",
        ),
    ] = "",
    seed: Annotated[
        int, typer.Option(help="random seed for world and noise")
    ] = _DEFAULTS.world.seed,
    strategy: Annotated[
        str,
        typer.Option(help="name of a strategy, or a class by its dotted path (current folder too)"),
    ] = _DEFAULTS.planner.strategy,
    max_views: Annotated[
        int, typer.Option(help="views after which it ends; 0: no limit")
    ] = _DEFAULTS.task.max_views,
    setting: Setting = None,
    overwrite: Overwrite = False,
    live: Live = False,
    settings: Annotated[bool, lists_settings(ExplorationOptions)] = False,
) -> None:
    """Explore a simulated world: report.html, map.png, map file, .ply and summary.json.

    Ctrl-C ends the run early: map and report of what was seen until then are written.
    """
    del settings  # the callback has answered it
    check_strategy(strategy)
    shortcuts: dict[str, tuple[str, object]] = {
        "--world": ("world.name", world),
        "--seed": ("world.seed", seed),
        "--size": ("world.size", size),
        "--strategy": ("planner.strategy", strategy),
        "--max-views": ("task.max_views", max_views),
    }
    known = RobotFile.read(robot).settings if robot else ()
    options = chosen(_DEFAULTS, shortcuts, setting, known)
    title = f"Exploring {options.world.title}"
    with results_in(out, overwrite), live_page(live, title, has_plans=True) as page:
        _explore(options, out, page)


def _explore(options: ExplorationOptions, out: Path, page: LivePage | None) -> None:
    console = Console(stderr=True)
    with RunProgress(console) as progress, says_when_it_compiles(console):
        watchers: list[Watcher] = [progress.show]
        run = _run_of(options, out, lambda entry: _notify(watchers, entry))
        for part in (*run.simulator.mended, *filter(None, [run.simulator.world.note])):
            console.print(f"infomap: {part}", markup=False)
        if page is not None:
            watchers.append(ExplorationDisplay(page, run.map, run.robot.link).show)
        stop = partial(run.control.ask, Request.STOP)
        with stops_when_interrupted(stop, console, "map and report"):
            ending = run.run()
    if run.simulator.advice:
        console.print(f"infomap: {run.simulator.advice}", markup=False)
    summary = run.write_results(ending)
    run.close()
    voxels = length(run.map.config.voxel_size)
    name = options.world.title
    try:
        draw_map_views(run.map, out / "map.png", f"Exploration of {name}")
    except InvalidInputError:  # nothing was seen
        (out / "map.png").unlink(missing_ok=True)
    sentences = [
        f"{name}: {ending.reason.value}, {ending.detail}".rstrip(", "),
        f"{summary['views']} views, {summary['distance']} m driven, "
        f"{100.0 * float(str(summary['known_fraction'])):.1f} % known, "
        f"{run.map.surface_voxels:,} surface voxels of {voxels}",
    ]
    say_results(sentences, summary, out, _FILES)
    if ending.reason is EndReason.FAILED:
        raise ExplorationError(ending.detail)
    if ending.reason is EndReason.STOPPED:
        raise typer.Exit(INTERRUPTED)


def _notify(watchers: Sequence[Watcher], entry: Mapping[str, Any]) -> None:
    """Notify all who watch the run of an entry of its log."""
    for watch in watchers:
        watch(entry)


def _run_of(options: ExplorationOptions, out: Path, on_entry: Watcher) -> ExplorationRun:
    """The run; what the robot lacks is asked for by the option that gives it."""
    try:
        return ExplorationRun(options, out, on_entry)
    except ConfigError as error:
        if not error.parameter.startswith("robot."):
            raise
        expected = f"{error.expected} (infomap robot {options.world.description} finds out)"
        option = f"--set simulator.{error.parameter}"
        raise ConfigError(option, error.value, expected) from error
