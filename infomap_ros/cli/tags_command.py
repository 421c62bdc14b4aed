"""Commands ``infomap tags`` and ``draw-target``."""

import csv
import io
import json
import sys
from collections import Counter
from pathlib import Path
from typing import Annotated, Any, Optional

import cv2
import typer

from infomap_ros.cli.command_options import Calibration
from infomap_ros.cli.results import results_in
from infomap_ros.errors import ConfigError, InvalidInputError
from infomap_ros.geometry import PinholeCamera
from infomap_ros.geometry.atomic_file import replacing, write_text
from infomap_ros.localization.target.tag_board import FAMILIES, TagBoard, TagBoardConfig, save_board
from infomap_ros.localization.target.tag_detection import (
    Tags,
    draw_tags,
    find_tags,
    read_photo,
    tag_positions,
)
from infomap_ros.replay.sequences.calibration_files import read_calibration


def tags(
    images: Annotated[list[Path], typer.Argument(help="photos", show_default=False)],
    out: Annotated[
        Path, typer.Option(help="folder for drawn photos and tags.csv", show_default=False)
    ],
    family: Annotated[
        str, typer.Option(help=f"{', '.join(FAMILIES)}; empty: that whose tags are the surest")
    ] = "",
    side: Annotated[
        Optional[float],
        typer.Option(help="edge of a black square [m]; with --calibration: where each tag is"),
    ] = None,
    calibration: Calibration = None,
) -> None:
    """Find tags in photos, and draw them."""
    if family and family not in FAMILIES:
        raise ConfigError("--family", family, f"one of {', '.join(FAMILIES)}")
    if (side is None) != (not calibration):
        raise InvalidInputError("--side", "goes with --calibration, and that with --side")
    rows: list[list[object]] = []
    read = 0
    stems = Counter(path.stem for path in images)
    with results_in(out, overwrite=True):
        for path in images:
            try:
                photo = read_photo(path)
            except InvalidInputError as error:
                typer.echo(f"infomap: {error}; left out", err=True)
                continue
            read += 1
            name, found = find_tags(photo, family)
            folder = path.resolve().parent.name if stems[path.stem] > 1 else ""
            drawn = "_".join([*([folder] if folder else []), path.stem, "tags.png"])
            with replacing(out / drawn) as file:
                file.write(cv2.imencode(".png", draw_tags(photo, found))[1].tobytes())
            positions = [""] * len(found.ids)
            if side is not None and calibration:
                size = (photo.shape[1], photo.shape[0])
                positions = _positions(found, side, calibration, size)
            photo_name = str(Path(folder, path.name))
            for one, corners, position in zip(found.ids, found.corners, positions, strict=True):
                rows.append([photo_name, name, int(one), *corners.ravel().round(3), position])
            if sys.stdout.isatty():
                ids = " ".join(str(one) for one in sorted(found.ids)) or "no tags"
                typer.echo(f"{path.name}: {len(found.ids)} of {name}: {ids}")
        _write(rows, out / "tags.csv")
    if sys.stdout.isatty():
        typer.echo(f"  {out}/*_tags.png  the photos with their tags\n  {out / 'tags.csv'}  corners")
        if not calibration:
            typer.echo("  where each tag is needs --side and --calibration")
    else:
        typer.echo(json.dumps({"photos": read, "tags": len(rows)}))
    if not read:
        raise InvalidInputError("images", "none of them could be read")
    if not rows:
        raise InvalidInputError("images", f"no tag of {family or 'any family'} was found")


def _positions(found: Tags, side: float, files: list[Path], size: tuple[int, int]) -> list[str]:
    """Middle of each tag in the optical frame, x y z [m]."""
    if not len(found.ids):
        return []
    raw = read_calibration(files, size).cameras[0]
    k = raw.intrinsics
    camera = PinholeCamera(raw.width, raw.height, k[0, 0], k[1, 1], k[0, 2], k[1, 2])
    flat = found.corners.reshape(-1, 1, 2)
    is_fisheye = raw.distortion_model == "equidistant"
    undistort: Any = cv2.fisheye.undistortPoints if is_fisheye else cv2.undistortPoints
    straight = undistort(flat, k, raw.distortion[:14], P=k).reshape(-1, 4, 2)
    places = tag_positions(found._replace(corners=straight), side, camera)
    return [" ".join(f"{value:.4f}" for value in place) for place in places]


def _write(rows: list[list[object]], path: Path) -> None:
    corners = [f"{axis}{corner}_px" for corner in range(4) for axis in "uv"]
    table = io.StringIO(newline="")
    csv.writer(table).writerows([["photo", "family", "id", *corners, "x y z [m]"], *rows])
    write_text(path, table.getvalue())


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
