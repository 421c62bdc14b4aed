"""Command line ``infomap``, also for machines without ROS."""

from __future__ import annotations

import os
import sys

import typer

from infomap_ros.cli.late_commands import (
    PASSED_ON,
    LateCommand,
    add_commands,
    new_app,
)
from infomap_ros.errors import InfomapError

COMMANDS = {
    "map": LateCommand(
        "infomap_ros.cli.map_command:map_bag",
        "Map a recorded bag: map file, .ply, pictures and summary.json.",
    ),
    "localize": LateCommand(
        "infomap_ros.cli.localize_command:localize",
        "Follow the camera through a bag: TUM trajectory, 6x6 covariances, picture, summary.json.",
    ),
    "explore": LateCommand(
        "infomap_ros.cli.explore_command:explore",
        "Explore a simulated world: map file, .ply, report.html and summary.json.",
    ),
    "show": LateCommand(
        "infomap_ros.cli.show_command:show",
        "Print what a map file holds, and draw it.",
    ),
    "convert": LateCommand(
        "infomap_ros.cli.convert_command:convert",
        "Turn a recorded sequence into a bag.",
    ),
    "draw-target": LateCommand(
        "infomap_ros.cli.draw_target_command:draw_target",
        "Draw a board of tags in true scale, and print the settings with which it is found.",
    ),
    "calibrate-noise": LateCommand(
        "infomap_ros.cli.calibrate_noise_command:calibrate_noise",
        "Fit the noise models of the stereo sensor to pairs with true disparity.",
    ),
    "study": LateCommand(
        "infomap_ros.cli.study_commands:app", "Experiments with the package, and their figures."
    ),
}

app = new_app("Stereo images to a probabilistic 3-D map with honest uncertainty.")
add_commands(app, COMMANDS)


@app.command("record-demo-bag", context_settings=PASSED_ON)
def record_demo_bag(context: typer.Context) -> None:
    """Record a stereo bag in simulation."""
    from infomap_ros.simulation.recorder import main as record

    record(context.args)


@app.command(context_settings=PASSED_ON)
def doctor(context: typer.Context) -> None:
    """Say what a live ROS graph lacks."""
    try:
        from infomap_ros.nodes.diagnosis.doctor import main as examine
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
