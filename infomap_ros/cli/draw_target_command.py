"""Command ``infomap draw-target``: the board of tags to print."""

import json
from pathlib import Path
from typing import Annotated

import typer

from infomap_ros.localization.target.tag_board import FAMILIES, TagBoard, TagBoardConfig, save_board

_DEFAULTS = TagBoardConfig()


def draw_target(
    out: Annotated[Path, typer.Option(help=".pdf or .png to write", show_default=False)],
    side: Annotated[float, typer.Option(help="edge of a black square [m]")] = _DEFAULTS.side,
    columns: Annotated[int, typer.Option(help="tags side by side")] = _DEFAULTS.columns,
    rows: Annotated[int, typer.Option(help="tags one below the other")] = _DEFAULTS.rows,
    gap: Annotated[float, typer.Option(help="gap between tags [m]")] = _DEFAULTS.gap,
    margin: Annotated[
        float, typer.Option(help="white margin around the tags [m]")
    ] = _DEFAULTS.margin,
    family: Annotated[
        str, typer.Option(help=f"family of the tags: {', '.join(FAMILIES)}")
    ] = _DEFAULTS.family,
    first_id: Annotated[int, typer.Option(help="first tag id (top left)")] = _DEFAULTS.first_id,
    mounting: Annotated[str, typer.Option(help="upright or flat")] = _DEFAULTS.mounting,
    dpi: Annotated[int, typer.Option(help="dots per inch")] = 300,
) -> None:
    """Draw a board of tags in true scale, and print the matching detector settings."""
    config = TagBoardConfig(
        family=family,
        side=side,
        columns=columns,
        rows=rows,
        gap=gap,
        margin=margin,
        first_id=first_id,
        mounting=mounting,
    )
    save_board(config, out, dpi)
    width, height = TagBoard(config).size
    names = ("family", "side", "columns", "rows", "gap", "margin", "first_id", "mounting")
    changed = [name for name in names if getattr(config, name) != getattr(_DEFAULTS, name)]
    settings = [f"target.tags.board.{name}={getattr(config, name)}" for name in changed]
    summary = {
        "file": str(out),
        "width": round(width, 6),
        "height": round(height, 6),
        "ids": " ".join(map(str, TagBoard(config).ids)),
        "settings": " ".join(f"--set {one}" for one in ("target.kind=tags", *settings)),
    }
    typer.echo(json.dumps(summary))
