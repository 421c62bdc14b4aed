"""Command ``infomap show``."""

import json
from pathlib import Path
from typing import Annotated, Optional

import numpy as np
import typer
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure

from infomap_ros.cli.command_options import Overwrite
from infomap_ros.cli.results import check_free
from infomap_ros.errors import InvalidInputError
from infomap_ros.geometry import PinholeCamera, transform_from_quaternion
from infomap_ros.geometry.atomic_file import save_figure
from infomap_ros.mapping import VoxelMap
from infomap_ros.mapping.files.pictures import draw_map_views
from infomap_ros.mapping.voxel_map import DepthImage

_LEAST_SIGMA = 1e-4  # that has a color of its own [m]


def draw_depth_image(image: DepthImage, path: Path) -> None:
    """Draw depth and sigma side by side; white where nothing is seen.

    Args:
        image: see `VoxelMap.render_depth`.
        path: PNG file to write.

    Raises:
        OSError: the file cannot be written.
    """
    figure = Figure(figsize=(14.0, 5.0), layout="constrained")
    left, right = figure.subplots(1, 2)
    depth = left.imshow(image.depth, cmap="viridis_r", interpolation="nearest")
    figure.colorbar(depth, ax=left, label="depth [m]", shrink=0.8)
    sigma = np.maximum(image.sigma, _LEAST_SIGMA)
    highest = float(np.nanmax(sigma)) if np.isfinite(sigma).any() else 1.0
    scale = LogNorm(_LEAST_SIGMA, max(highest, 2.0 * _LEAST_SIGMA))
    drawn = right.imshow(sigma, cmap="magma", norm=scale, interpolation="nearest")
    figure.colorbar(drawn, ax=right, label="sigma of the depth [m]", shrink=0.8)
    for axes in (left, right):
        axes.set(xlabel="u [px]", ylabel="v [px]")
    save_figure(figure, path, 110)


_CAMERA = PinholeCamera(640, 480, 525.0, 525.0, 319.5, 239.5)
_POSE_NUMBERS = 7


def show(
    map_file: Annotated[Path, typer.Argument(help="a map file", show_default=False)],
    out: Annotated[
        Optional[Path], typer.Option(help="picture to write (.png); MAP_shown.png else")
    ] = None,
    view_from: Annotated[
        Optional[str],
        typer.Option(
            "--from",
            help="also draw the depth and its sigma that a camera (640x480, 63 degrees wide) sees "
            'from a pose of its optical frame: "X Y Z QX QY QZ QW", as in trajectory files [m]',
        ),
    ] = None,
    overwrite: Overwrite = False,
) -> None:
    """Print what a map file holds, and draw it."""
    picture = (out or map_file.with_name(f"{map_file.stem}_shown")).with_suffix(".png")
    if out is not None:
        check_free(picture, overwrite)
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
    if view_from is not None:
        seen = picture.with_name(f"{picture.stem}_depth.png")
        figures |= _draw_view(voxel_map, view_from, seen)
    draw_map_views(voxel_map, picture)
    typer.echo(json.dumps(figures | {"picture": str(picture)}))


def _draw_view(voxel_map: VoxelMap, view_from: str, picture: Path) -> dict[str, object]:
    """Draw what is seen from a pose; returns figures of it."""
    try:
        numbers = [float(word) for word in view_from.replace(",", " ").split()]
    except ValueError as error:
        raise InvalidInputError("--from", f"'{view_from}' holds what is no number") from error
    if len(numbers) != _POSE_NUMBERS:
        raise InvalidInputError("--from", f"has {len(numbers)} numbers, expected X Y Z QX QY QZ QW")
    image = voxel_map.render_depth(_CAMERA, transform_from_quaternion(numbers[3:], numbers[:3]))
    draw_depth_image(image, picture)
    is_seen = np.isfinite(image.depth)
    middle = float(np.median(image.depth[is_seen])) if is_seen.any() else None
    return {
        "depth_picture": str(picture),
        "seen_share": round(float(is_seen.mean()), 4),
        "median_depth": middle if middle is None else round(middle, 4),
    }
