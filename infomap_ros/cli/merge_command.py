"""Command ``infomap merge``."""

import json
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

from infomap_ros.cli.command_options import Overwrite
from infomap_ros.cli.results import check_free
from infomap_ros.errors import InvalidInputError
from infomap_ros.mapping import VoxelMap
from infomap_ros.team.agreement import LEAST_COMPARED
from infomap_ros.team.merging import NamedMap, aligned_maps, merge_maps
from infomap_ros.team.registration import Registration


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
    align: Annotated[
        bool,
        typer.Option(
            "--align",
            help="the maps have no frame in common: find out by surface and free space how each "
            "lies in those before it, and bring it into the frame of the first",
        ),
    ] = False,
    overwrite: Overwrite = False,
) -> None:
    """Join maps of several sessions or robots that are in one frame.

    With --align they are brought into one. The sums are the same in any order. Maps that
    contradict each other, hold the same session, or differ in the size of their voxels are
    refused. A new file gets the settings of the first.
    """
    if len(map_files) < 2:
        raise InvalidInputError("map files", "there is one, expected two or more")
    check_free(out, overwrite)
    maps = [NamedMap(str(path), VoxelMap.load(path)) for path in map_files]
    placed = aligned_maps(maps) if align else []
    maps = [maps[0], *(moved for moved, _ in placed)] if align else maps
    merged, agreement = merge_maps(maps, common_frame or align)
    merged.save(out)
    if agreement.compared < LEAST_COMPARED and len({one.map.origin for one in maps} - {0}) != 1:
        typer.echo(
            f"infomap: the maps have {agreement.compared} surface voxels in common, which does not "
            "tell whether they are in one frame",
            err=True,
        )
    figures: dict[str, Any] = {
        "maps": len(maps),
        "sessions": len(merged.sessions),
        "known_voxels": merged.known_voxels,
        "surface_voxels": merged.surface_voxels,
        "compared_voxels": agreement.compared,
        "contradicting_voxels": agreement.contradicted,
        "map": str(out),
    }
    if align:
        figures["aligned"] = [_place(moved.name, found) for moved, found in placed]
    typer.echo(json.dumps(figures))


def _place(name: str, found: Registration) -> dict[str, Any]:
    """Where a map was found in that of the first file."""
    deviations = np.sqrt(found.covariance.diagonal())
    return {
        "map": name,
        "T_first_map": found.T_first_second.tolist(),
        "sigma_m": round(float(np.linalg.norm(deviations[:3])), 4),
        "sigma_deg": round(float(np.degrees(np.linalg.norm(deviations[3:]))), 3),
        "matched_voxels": found.matched,
        "contradicted_voxels": found.contradicted,
        "matched_elsewhere": found.rival,
    }
