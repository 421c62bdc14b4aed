"""Command ``infomap convert``."""

import json
from functools import partial
from pathlib import Path
from typing import Annotated, Optional

import typer

from infomap_ros.cli.command_options import Calibration
from infomap_ros.replay.sequences import LAYOUTS, SequenceOptions
from infomap_ros.replay.sequences import convert as convert_sequence

_DEFAULTS = SequenceOptions()
_WORDS = {"auto": None, "yes": True, "no": False}


def convert(
    layout: Annotated[str, typer.Argument(metavar="LAYOUT", help=", ".join(LAYOUTS))],
    folder: Annotated[Path, typer.Argument(help="where the images are", show_default=False)],
    out: Annotated[
        Path, typer.Argument(metavar="BAG", help="folder of the bag", show_default=False)
    ],
    calibration: Calibration = None,
    left: Annotated[str, typer.Option(help="folder or pattern of the left images")] = "",
    right: Annotated[str, typer.Option(help="folder or pattern of the right images")] = "",
    depth: Annotated[str, typer.Option(help="folder or pattern of the depth images")] = "",
    color: Annotated[str, typer.Option(help="folder or pattern of the color images")] = "",
    stamps: Annotated[
        Optional[Path],
        typer.Option(help="file of times, or of times and names; else those in the images' names"),
    ] = None,
    rate: Annotated[
        float, typer.Option(help="of frames that are only numbered [Hz]")
    ] = _DEFAULTS.rate,
    poses: Annotated[
        Optional[Path], typer.Option(help="poses: TUM, EuRoC or KITTI (else looked for)")
    ] = None,
    depth_unit: Annotated[
        float, typer.Option(help="of the numbers in depth images [m]; 0: 0.001, in tum 0.0002")
    ] = _DEFAULTS.depth_unit,
    rectified: Annotated[
        str, typer.Option(help="whether the images are rectified: auto (calibration), yes, no")
    ] = "auto",
    overwrite: Annotated[bool, typer.Option("--overwrite", help="replace a bag")] = False,
) -> None:
    """Turn a folder of images into a bag.

    LAYOUT images: left and right (or depth and color) in folders or by names. euroc: cam0, cam1
    (EuRoC, TUM-VI). kitti: image_0, image_1. tum: rgb.txt, depth.txt. rgbd: frame-N.depth.png,
    frame-N.color.jpg, frame-N.pose.txt. Any of them is also mapped directly: infomap map FOLDER.
    """
    if rectified not in _WORDS:
        raise typer.BadParameter("expected auto, yes or no", param_hint="--rectified")
    options = SequenceOptions(
        calibration=tuple(calibration or ()),
        left=left,
        right=right,
        depth=depth,
        color=color,
        stamps=stamps,
        rate=rate,
        poses=poses,
        depth_unit=depth_unit,
        is_rectified=_WORDS[rectified],
    )
    say = partial(typer.echo, err=True)
    count = convert_sequence(layout, folder, out, options, overwrite, say)
    typer.echo(json.dumps({"bag": str(out), "messages": count}))
