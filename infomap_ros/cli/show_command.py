"""Command ``infomap show``."""

import json
from pathlib import Path
from typing import Annotated, Optional

import typer

from infomap_ros.mapping import VoxelMap
from infomap_ros.mapping.files.pictures import draw_map_views


def show(
    map_file: Annotated[Path, typer.Argument(help="a map file", show_default=False)],
    out: Annotated[Optional[Path], typer.Option(help="picture to write (.png)")] = None,
) -> None:
    """Print what a map file holds, and draw it."""
    voxel_map = VoxelMap.load(map_file)
    bounds, size = voxel_map.bounds(), voxel_map.config.voxel_size
    figures = {
        "voxel_size": size,
        "known_voxels": voxel_map.known_voxels,
        "surface_voxels": voxel_map.surface_voxels,
        "entropy_bits": round(voxel_map.entropy_bits(), 1),
        "memory_bytes": voxel_map.memory_bytes(),
        "low": None if bounds is None else (bounds[0] * size).round(3).tolist(),
        "high": None if bounds is None else ((bounds[1] + 1) * size).round(3).tolist(),
    }
    picture = (out or map_file).with_suffix(".png")
    draw_map_views(voxel_map, picture)
    typer.echo(json.dumps(figures | {"picture": str(picture)}))
