"""Command ``infomap calibrate-noise``."""

import json
from dataclasses import dataclass, field
from itertools import cycle
from pathlib import Path
from typing import Annotated, Any, Optional

import numpy as np
import typer

from infomap_ros.cli.command_options import chosen, lists_settings
from infomap_ros.cli.results import results_in
from infomap_ros.geometry.atomic_file import save_figure, write_text
from infomap_ros.stereo import StereoConfig, calibration
from infomap_ros.stereo.calibration import NoiseFit
from infomap_ros.stereo.evaluation import GAUSSIAN_SHARES, PairErrors, load_pairs

_BINS = 12


def draw_noise_fit(fit: NoiseFit, path: Path | str) -> None:
    """Draw predicted against found errors, the shares, and the fit of eq. (1).

    Args:
        fit: result of `calibrate_noise`.
        path: file to write, format by its ending.
    """
    # Matplotlib takes longer to import than all the rest; only this function needs it.
    from matplotlib.figure import Figure

    figure = Figure(figsize=(13.0, 4.2), layout="constrained")
    axes = figure.subplots(1, 3)
    _draw_prediction(axes[0], fit)
    _draw_shares(axes[1], fit)
    _draw_printed(axes[2], fit)
    save_figure(figure, path, 110)


def _styles() -> Any:
    """Color and marker of each pair, after M. Okabe and K. Ito told apart by the color-blind."""
    colors = "#E69F00", "#0072B2", "#009E73", "#CC79A7", "#D55E00", "#56B4E9"
    return cycle(zip(colors, "os^Dv*", strict=True))


def _draw_prediction(axes: Any, fit: NoiseFit) -> None:
    """Found against predicted sigma, in bins of equal number; on the diagonal is right."""
    for report, (color, marker) in zip(fit.reports, _styles(), strict=False):
        predicted, found = _binned(report.errors)
        axes.loglog(predicted, found, f"{marker}-", color=color, label=report.errors.pair.name)
    ends = np.array([0.05, 1.0])
    axes.loglog(ends, ends, "k:", label="prediction = truth")
    axes.set(
        xlabel="predicted sigma, truth's included [px]",
        ylabel="68 % of errors are smaller than [px]",
        title="disparity model",
    )
    axes.legend(loc="upper left")


def _binned(errors: PairErrors) -> tuple[list[float], list[float]]:
    inliers = errors.inliers
    sigma = np.hypot(errors.sigma[inliers], errors.pair.truth_sigma)
    error = np.abs(errors.error[inliers])
    groups = np.array_split(np.argsort(sigma), _BINS)
    predicted = [float(np.median(sigma[group])) for group in groups]
    return predicted, [float(np.quantile(error[group], GAUSSIAN_SHARES[0])) for group in groups]


def _draw_shares(axes: Any, fit: NoiseFit) -> None:
    """Distribution of the normalized errors over a Gaussian's."""
    multiples = np.linspace(0.0, 4.0, 81)
    for report, (color, _) in zip(fit.reports, _styles(), strict=False):
        errors = report.errors
        inliers = errors.inliers
        sigma = np.hypot(errors.sigma[inliers], errors.pair.truth_sigma)
        ratio = np.sort(np.abs(errors.error[inliers]) / sigma)
        shares = np.searchsorted(ratio, multiples) / ratio.size
        axes.plot(multiples, 100.0 * shares, color=color, label=errors.pair.name)
    for multiple, share in enumerate(GAUSSIAN_SHARES, start=1):
        axes.errorbar(multiple, 100.0 * share, 5.0, fmt="k_", capsize=4)
    axes.set(
        xlabel="multiple of the predicted sigma",
        ylabel="share of inliers within [%]",
        title="normalized errors; bars: Gaussian, 5 points",
    )
    axes.legend(loc="lower right")


def _draw_printed(axes: Any, fit: NoiseFit) -> None:
    """Depth errors over distance and the fitted eq. (1), both times f B."""
    printed = fit.printed
    drawn = zip(printed.names, printed.distances, printed.sigmas, strict=True)
    for (name, distances, sigmas), (color, marker) in zip(drawn, _styles(), strict=False):
        axes.loglog(distances, sigmas, marker, color=color, label=name)
    span = np.geomspace(printed.distances.min(), printed.distances.max(), 50)
    label = f"S T_z L^n, S = {printed.s:g} px / (f B), n = {printed.n:g}"
    axes.loglog(span, printed.s * span**printed.n, "k-", label=label)
    axes.set(
        xlabel="distance L [m]",
        ylabel="68 % depth error times f B [px m^2]",
        title="printed model, eq. (1)",
    )
    axes.set_ylim(top=10.0 * float(np.nanmax(printed.sigmas)))  # room for the legend
    axes.legend(loc="upper left")


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
