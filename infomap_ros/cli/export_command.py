"""Command ``infomap export``."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, NamedTuple, Optional

import typer

from infomap_ros.cli.command_options import Overwrite
from infomap_ros.cli.results import check_free
from infomap_ros.errors import ConfigError
from infomap_ros.mapping import VoxelMap
from infomap_ros.mapping.files.export import (
    ProjectionConfig,
    write_distances,
    write_grid,
    write_ply,
    write_stl,
)
from infomap_ros.mapping.files.octomap_file import write_bt, write_ot

_BAND = ProjectionConfig()


class _Format(NamedTuple):
    suffix: str
    write: Callable[[VoxelMap, Path], object]


_FORMATS = {
    "ply": _Format(".ply", write_ply),
    "ot": _Format(".ot", write_ot),
    "bt": _Format(".bt", write_bt),
    "grid": _Format(".yaml", write_grid),
    "mesh": _Format(".stl", write_stl),
    "distance": _Format(".npz", write_distances),
}


def export(
    map_file: Annotated[Path, typer.Argument(help="a map file", show_default=False)],
    format: Annotated[
        str,
        typer.Option(
            help="ply: surface points with probability and sigma; ot, bt: OctoMap with log-odds, "
            "or free and occupied only; grid: .yaml and .pgm for map_server; mesh: .stl of the "
            "faces of occupied voxels; distance: .npz with the distance to what is not free",
            show_default=False,
        ),
    ],
    out: Annotated[
        Optional[Path], typer.Option(help="file to write, else beside the map file")
    ] = None,
    low: Annotated[
        float, typer.Option(help="lower end of the heights that grid takes [m]")
    ] = _BAND.low,
    high: Annotated[float, typer.Option(help="upper end of them [m]")] = _BAND.high,
    overwrite: Overwrite = False,
) -> None:
    """Write a map file in a format of other programs."""
    chosen = _FORMATS.get(format)
    if chosen is None:
        raise ConfigError("--format", format, f"one of {', '.join(_FORMATS)}")
    path = out or map_file.with_suffix(chosen.suffix)
    written = [path, path.with_suffix(".pgm")] if format == "grid" else [path]
    for file in written:
        check_free(file, overwrite)
    voxel_map = VoxelMap.load(map_file)
    if format == "grid":
        write_grid(voxel_map, path, ProjectionConfig(low=low, high=high))
    else:
        chosen.write(voxel_map, path)
    typer.echo(json.dumps({file.suffix.lstrip("."): str(file) for file in written}))
