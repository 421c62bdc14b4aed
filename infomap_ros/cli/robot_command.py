"""Command ``infomap robot``: read a robot's URDF, and write the file that names its parts."""

from pathlib import Path
from typing import Annotated

import typer

from infomap_ros import __version__
from infomap_ros.cli.results import check_free, results_in, says_when_it_compiles
from infomap_ros.errors import InvalidInputError, RobotModelError
from infomap_ros.geometry.atomic_file import write_text
from infomap_ros.simulation.robots.drawing import draw_robot
from infomap_ros.simulation.robots.robot_file import RobotFile
from infomap_ros.simulation.robots.robot_reading import RobotReading, read_robot


def robot(
    urdf: Annotated[
        str, typer.Argument(help="URDF file, or its package:// address", show_default=False)
    ],
    out: Annotated[
        Path, typer.Option(help="file to write; the drawing gets its name, .png")
    ] = Path("robot.yaml"),
    camera: Annotated[
        str,
        typer.Option(
            help="optical frame of the left camera, or a link on which to put one",
            show_default="the one that most joints move",
        ),
    ] = "",
    overwrite: Annotated[bool, typer.Option("--overwrite", help="replace the file")] = False,
) -> None:
    """Read a robot's URDF: say what is understood and guessed, write its file, draw it."""
    if out.suffix not in (".yaml", ".yml"):
        raise InvalidInputError("--out", f"{out} is no .yaml file")
    check_free(out, overwrite)
    with results_in(out.parent, overwrite=True):
        _write(urdf, out, camera)


def _write(urdf: str, out: Path, camera: str) -> None:
    with says_when_it_compiles():
        reading = read_robot(urdf, camera)
    _say(reading)
    title = f"{reading.robot.name}, written by infomap robot {__version__}"
    text = reading.file.text(title)
    write_text(out, text)
    RobotFile.read(out)  # it says what was meant
    picture = out.with_suffix(".png")
    draw_robot(reading, picture)
    if not reading.stands:
        text = f"tips over where it stands (see {picture}): complete {out}, as robot.casters"
        raise RobotModelError(f"robot '{reading.robot.name}' {text}")
    typer.echo(f"\nwrote {out} and {picture}; next: infomap explore --robot {out} --world office")


def _say(reading: RobotReading) -> None:
    parts = (
        ("Understood", reading.understood, typer.colors.GREEN),
        ("Guessed", reading.guesses, typer.colors.YELLOW),
        ("Warnings", reading.warnings, typer.colors.RED),
    )
    for title, lines, color in parts:
        if lines:
            typer.secho(title, fg=color, bold=True)
            typer.echo("\n".join(f"  {line}" for line in lines))
