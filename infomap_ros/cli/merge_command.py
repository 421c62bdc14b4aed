"""Command ``infomap merge``."""

import json
from pathlib import Path
from typing import Annotated

import typer

from infomap_ros.cli.command_options import Overwrite
from infomap_ros.cli.results import check_free
from infomap_ros.errors import InvalidInputError
from infomap_ros.mapping import VoxelMap
from infomap_ros.team.agreement import LEAST_COMPARED
from infomap_ros.team.merging import NamedMap, merge_maps


def merge(
    map_files: Annotated[
        list[Path], typer.Argument(help="map files, two or more", show_default=False)
    ],
    out: Annotated[Path, typer.Option(help="map file to write", show_default=False)],
    common_frame: Annotated[
        bool,
        typer.Option(
            "--common-frame",
            help="the maps are in one frame although they began at other origins: of robots that "
            "were aligned by tags or by hand",
        ),
    ] = False,
    overwrite: Overwrite = False,
) -> None:
    """Join maps of several sessions or robots that are in one frame.

    The sums are the same in any order. Maps that contradict each other, hold the same session,
    or differ in the size of their voxels are refused. A new file gets the settings of the first.
    """
    if len(map_files) < 2:
        raise InvalidInputError("map files", "there is one, expected two or more")
    check_free(out, overwrite)
    maps = [NamedMap(str(path), VoxelMap.load(path)) for path in map_files]
    merged, agreement = merge_maps(maps, common_frame)
    merged.save(out)
    if agreement.compared < LEAST_COMPARED and len({one.map.origin for one in maps} - {0}) != 1:
        typer.echo(
            f"infomap: the maps have {agreement.compared} surface voxels in common, which does not "
            "tell whether they are in one frame",
            err=True,
        )
    figures = {
        "maps": len(maps),
        "sessions": len(merged.sessions),
        "known_voxels": merged.known_voxels,
        "surface_voxels": merged.surface_voxels,
        "compared_voxels": agreement.compared,
        "contradicting_voxels": agreement.contradicted,
        "map": str(out),
    }
    typer.echo(json.dumps(figures))
