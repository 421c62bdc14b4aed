"""Command ``infomap calibrate-noise``."""

import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Optional

import typer

from infomap_ros.cli.command_options import chosen, lists_settings
from infomap_ros.cli.results import results_in
from infomap_ros.geometry.atomic_file import write_text
from infomap_ros.stereo import StereoConfig, calibration
from infomap_ros.stereo.ground_truth import load_pairs
from infomap_ros.stereo.noise_plot import draw_noise_fit


@dataclass(frozen=True)
class CalibrationOptions:
    """All settings of a calibration."""

    stereo: StereoConfig = field(default_factory=StereoConfig)


def calibrate_noise(
    folders: Annotated[
        list[Path], typer.Argument(help="folders of pairs with true disparity", show_default=False)
    ],
    out: Annotated[Path, typer.Option(help="folder for plot and summary.json", show_default=False)],
    setting: Annotated[
        Optional[list[str]],
        typer.Option("--set", metavar="stereo.NAME=VALUE", help="of the sensor"),
    ] = None,
    half_sizes: Annotated[bool, typer.Option(help="fit to the pairs at half size too")] = True,
    settings: Annotated[bool, lists_settings(CalibrationOptions)] = False,
) -> None:
    """Fit the noise models of the stereo sensor to pairs with true disparity."""
    del settings  # the callback has answered it
    config = chosen(CalibrationOptions(), {}, setting).stereo
    pairs = [pair for folder in folders for pair in load_pairs(folder)]
    with results_in(out, overwrite=True):
        fit = calibration.calibrate_noise(pairs, config, half_sizes=half_sizes)
        draw_noise_fit(fit, out / "noise.png")
        summary = fit.summary()
        write_text(out / "summary.json", json.dumps(summary, indent=1) + "\n")
    typer.echo(fit.table())
    typer.echo(json.dumps(summary))
