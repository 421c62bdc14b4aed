"""Command line ``infomap``, also for machines without ROS."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Mapping
from importlib import import_module
from typing import Any, NamedTuple

import typer

from infomap_ros import __version__
from infomap_ros.errors import InfomapError

PASSED_ON = {
    "allow_extra_args": True,
    "ignore_unknown_options": True,
    "help_option_names": [],  # --help is the other command's
}
"""Context settings of a command that hands all its arguments to another one."""
_HELPS = {"help_option_names": ["-h", "--help"]}


class LateCommand(NamedTuple):
    """A command, or a group of them, that is loaded when it is called.

    Attributes:
        place: ``module:name`` of a function that typer can make a command of, or of a group.
        help: what the list of commands says: the first line of its docstring, or of the group.
        example: a command line that its help ends with; empty for a group.
    """

    place: str
    help: str
    example: str = ""

    def load(self) -> Any:
        """The function or group."""
        module, name = self.place.split(":")
        return getattr(import_module(module), name)


def add_commands(app: typer.Typer, commands: Mapping[str, LateCommand]) -> None:
    """Add commands by their names to an application."""
    for name, command in commands.items():
        app.command(name, help=command.help, context_settings=PASSED_ON)(_passing_on(command))


def new_app(help: str, has_completion: bool = False) -> typer.Typer:
    """An application in the manner of all of the package's."""
    return typer.Typer(
        help=help,
        no_args_is_help=True,
        pretty_exceptions_enable=False,
        rich_markup_mode="markdown",  # leaves the brackets of units alone
        add_completion=has_completion,
        context_settings=_HELPS,
    )


def _passing_on(command: LateCommand) -> Callable[[typer.Context], None]:
    def pass_on(context: typer.Context) -> None:
        loaded = command.load()
        app = loaded
        if not isinstance(loaded, typer.Typer):
            app = new_app(command.help)
            example = f"Example: `{command.example}`"
            app.command(context_settings=_HELPS, epilog=example)(loaded)
        app(context.args, prog_name=context.command_path)

    return pass_on


COMMANDS = {
    "map": LateCommand(
        "infomap_ros.cli.map_command:map_bag",
        "Map a bag or a folder of images: map.html, map.png, map file, .ply and summary.json.",
        "infomap map bags/rover_rocks --out out/rocks",
    ),
    "localize": LateCommand(
        "infomap_ros.cli.localize_command:localize",
        "Estimate the camera's trajectory: TUM file, 6x6 covariances, picture, summary.json.",
        "infomap localize bags/rover_rocks --out out/trajectory",
    ),
    "explore": LateCommand(
        "infomap_ros.cli.explore_command:explore",
        "Explore a simulated world: report.html, map.png, map file, .ply and summary.json.",
        "infomap explore --world office --seed 3 --max-views 10 --out out/office",
    ),
    "robot": LateCommand(
        "infomap_ros.cli.robot_command:robot",
        "Read a robot's URDF: say what is understood and guessed, write its file, draw it.",
        "infomap robot my_robot.urdf --out robot.yaml",
    ),
    "report": LateCommand(
        "infomap_ros.cli.report_command:report",
        "Write the report of an exploration from its log and map, or compare several on one page.",
        "infomap report out/random out/largest_information --out comparison.html",
    ),
    "show": LateCommand(
        "infomap_ros.cli.map_file_commands:show",
        "Print what a map file holds, and draw it.",
        "infomap show out/rocks/map.infomap --out rocks.png",
    ),
    "merge": LateCommand(
        "infomap_ros.cli.map_file_commands:merge",
        "Join maps of several sessions or robots that are in one frame.",
        "infomap merge monday.infomap tuesday.infomap --out both.infomap",
    ),
    "changes": LateCommand(
        "infomap_ros.cli.map_file_commands:changes",
        "Say what appeared and what vanished between two maps of one place.",
        "infomap changes monday.infomap tuesday.infomap --out changed.ply",
    ),
    "export": LateCommand(
        "infomap_ros.cli.map_file_commands:export",
        "Write a map file in a format of other programs.",
        "infomap export out/rocks/map.infomap --format bt --out rocks.bt",
    ),
    "convert": LateCommand(
        "infomap_ros.cli.convert_command:convert",
        "Turn a folder of images into a bag.",
        "infomap convert kitti sequences/03 kitti_03",
    ),
    "tags": LateCommand(
        "infomap_ros.cli.tags_command:tags",
        "Find tags in photos, and draw them.",
        "infomap tags photos/*.jpg --family tag36h11 --out out/tags",
    ),
    "draw-target": LateCommand(
        "infomap_ros.cli.tags_command:draw_target",
        "Draw a board of tags in true scale, and print the matching detector settings.",
        "infomap draw-target --columns 3 --rows 2 --side 0.08 --out board.pdf",
    ),
    "calibrate-noise": LateCommand(
        "infomap_ros.cli.calibrate_noise_command:calibrate_noise",
        "Fit the noise models of the stereo sensor to pairs with true disparity.",
        "infomap calibrate-noise middlebury/Motorcycle --out out/noise",
    ),
    "study": LateCommand(
        "infomap_ros.cli.study_commands:app", "Experiments with the package, and their figures."
    ),
}

app = new_app(
    "Build probabilistic 3-D maps from stereo or depth images, with calibrated uncertainty.",
    has_completion=True,
)
add_commands(app, COMMANDS)


def _print_version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"infomap_ros {__version__}")
        raise typer.Exit


@app.callback()
def _options(
    version: bool = typer.Option(
        False, "--version", callback=_print_version, is_eager=True, help="print it, and end"
    ),
) -> None:
    """Answered by the callback of its option."""


@app.command("record-demo-bag", context_settings=PASSED_ON)
def record_demo_bag(context: typer.Context) -> None:
    """Record a stereo bag in simulation."""
    from infomap_ros.simulation.recorder import main as record

    record(context.args)


@app.command(context_settings=PASSED_ON)
def doctor(context: typer.Context) -> None:
    """Diagnose a running ROS system: missing topics, frames, calibration."""
    try:
        from infomap_ros.nodes.doctor import main as examine
    except ModuleNotFoundError as error:
        raise InfomapError(f"the doctor needs ROS 2, and there is no {error.name}") from error
    raise typer.Exit(examine(context.args))


def main() -> None:
    """Run the command line; errors end it with one line and exit status 1."""
    # Read where a command, or a process that it starts, loads OpenBLAS, whose threads spin, and
    # slow down small problems.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    try:
        app()
    except (InfomapError, OSError) as error:
        sys.exit(f"infomap: {error}")
    except KeyboardInterrupt:
        sys.exit("infomap: interrupted")
