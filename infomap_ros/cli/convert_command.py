"""Command ``infomap convert``."""

import json
from pathlib import Path
from typing import Annotated

import typer

from infomap_ros.replay.sequences import FORMATS
from infomap_ros.replay.sequences import convert as convert_sequence


def convert(
    form: Annotated[str, typer.Argument(metavar="FORMAT", help=", ".join(FORMATS))],
    folder: Annotated[Path, typer.Argument(help="where the sequence is", show_default=False)],
    out: Annotated[Path, typer.Argument(help="folder of the bag", show_default=False)],
    overwrite: Annotated[bool, typer.Option(help="replace a bag that is there")] = False,
) -> None:
    """Turn a recorded sequence into a bag."""
    count = convert_sequence(form, folder, out, overwrite)
    typer.echo(json.dumps({"bag": str(out), "messages": count}))
