"""Commands on map files: ``infomap show``, ``merge``, ``changes`` and ``export``."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any, NamedTuple, Optional

import numpy as np
import typer
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure

from infomap_ros.cli.command_options import Overwrite
from infomap_ros.cli.results import check_free
from infomap_ros.errors import ConfigError, InvalidInputError
from infomap_ros.geometry import PinholeCamera, transform_from_quaternion
from infomap_ros.geometry.atomic_file import save_figure
from infomap_ros.mapping import VoxelMap
from infomap_ros.mapping.files.export import (
    PLY_VERTEX,
    ProjectionConfig,
    write_distances,
    write_grid,
    write_ply,
    write_stl,
    write_vertices,
)
from infomap_ros.mapping.files.octomap_file import write_bt, write_ot
from infomap_ros.mapping.files.pictures import draw_map_views
from infomap_ros.mapping.voxel_map import DepthImage
from infomap_ros.team.agreement import LEAST_COMPARED, compare_maps
from infomap_ros.team.map_changes import ChangedObject, MapChanges, changes_between
from infomap_ros.team.merging import NamedMap, aligned_maps, merge_maps
from infomap_ros.team.registration import Registration, register_maps

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


_CHANGES_COLORS = ((220, 40, 30), (40, 90, 220))  # appeared, vanished


def changes(
    old: Annotated[Path, typer.Argument(help="the earlier map file", show_default=False)],
    new: Annotated[Path, typer.Argument(help="the later one", show_default=False)],
    align: Annotated[
        bool,
        typer.Option(
            "--align",
            help="the maps have no frame in common: find out by surface and free space how the "
            "later one lies in the earlier one, with its covariance",
        ),
    ] = False,
    out: Annotated[
        Optional[Path],
        typer.Option(
            help="point cloud to write (.ply): changed surface with the probability that it has "
            "changed, red where it appeared, blue where it vanished"
        ),
    ] = None,
    overwrite: Overwrite = False,
) -> None:
    """Say what appeared and what vanished between two maps of one place.

    By the evidence of both where both have seen the place; a surface that moved by no more than the
    sigmas of both maps, and of their registration, explain is no change. A line for each object,
    and how much of each map the other one could see; coordinates are those of OLD.
    """
    if out is not None:
        check_free(out, overwrite)
    before, after = (NamedMap(str(path), VoxelMap.load(path)) for path in (old, new))
    place = register_maps(before.map, after.map) if align else None
    found = changes_between(before, after, place)
    for each in found.objects:
        typer.echo(_line_of(each), err=True)
    sides = ("OLD", found.vanished, "NEW"), ("NEW", found.appeared, "OLD")
    shares = [_share(side.compared, side.surface_voxels) for _, side, _ in sides]
    for (name, side, other), share in zip(sides, shares, strict=True):
        typer.echo(
            f"{other} could see {share:.1%} of the {side.surface_voxels} surface voxels of {name}"
            + ("; of the rest nothing is said" if share < 1.0 else ""),
            err=True,
        )
    if not align and compare_maps(before.map, after.map).is_contradiction:
        typer.echo(
            "infomap: the maps contradict each other in most of what both have seen: they may not "
            "be in one frame (--align)",
            err=True,
        )
    figures: dict[str, Any] = {
        "objects": [_figures_of(each) for each in found.objects],
        "appeared_voxels": len(found.appeared.points),
        "vanished_voxels": len(found.vanished.points),
        "scattered_voxels": found.scattered,
        "old_surface_voxels": found.vanished.surface_voxels,
        "old_seen_share": round(shares[0], 4),
        "new_surface_voxels": found.appeared.surface_voxels,
        "new_seen_share": round(shares[1], 4),
    }
    if place is not None:
        figures["aligned"] = _place(str(new), place)
    if out is not None:
        _write_changes(found, out)
        figures["ply"] = str(out)
    typer.echo(json.dumps(figures))


def _share(part: int, whole: int) -> float:
    return part / whole if whole else 0.0


def _line_of(each: ChangedObject) -> str:
    sides = (f"{low:.2f} to {high:.2f}" for low, high in each.box.T)
    where = ", ".join(f"{axis} {side}" for axis, side in zip("xyz", sides, strict=True))
    return (
        f"{each.what}: {where} m, surface {each.surface:.2f} m^2, {each.voxels} voxels, "
        f"probability {each.probability:.3f}"
    )


def _figures_of(each: ChangedObject) -> dict[str, Any]:
    return {
        "what": each.what,
        "low": each.box[0].round(4).tolist(),
        "high": each.box[1].round(4).tolist(),
        "surface_m2": round(each.surface, 4),
        "voxels": each.voxels,
        "probability": round(each.probability, 4),
    }


def _write_changes(found: MapChanges, path: Path) -> None:
    """The changed surface as a point cloud."""
    parts = []
    for side, color in zip((found.appeared, found.vanished), _CHANGES_COLORS, strict=True):
        vertices = np.zeros(len(side.points), PLY_VERTEX)
        vertices["x"], vertices["y"], vertices["z"] = side.points.T
        vertices["probability"], vertices["sigma"] = side.probabilities, side.sigmas
        vertices["red"], vertices["green"], vertices["blue"] = color
        parts.append(vertices)
    comment = "position in m, probability of a change; red appeared, blue vanished"
    write_vertices(np.concatenate(parts), path, comment)


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
