"""What views a robot takes when a surface is to be known to 30, 10 or 5 mm, in one world.

The same world is explored once for each standard deviation that is asked for
(`task.surface_sigma`). One JSON line per exploration, then a table, and a picture: where the views
are, from above, and how far away from the camera what they look at is.

    python benchmarks/surface_precision.py --sigmas 0.03 0.01 0.005 --out DIR
"""

from __future__ import annotations

import argparse
import json
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np

from infomap_ros.cli.command_options import with_settings
from infomap_ros.exploration.records.recorded_run import read_run
from infomap_ros.exploration.records.run_log import Decision
from infomap_ros.geometry.atomic_file import save_figure, write_json
from infomap_ros.mapping.files.export import surface_sigmas
from infomap_ros.simulation.exploring.exploration_run import (
    LOG_FILE,
    ExplorationOptions,
    ExplorationRun,
)

ROW_FILE = "row.json"
_SPREAD = np.linspace(-0.3, 0.3, 7)  # tangents of the directions in which a view's range is taken


def kept_or_new(sigma: float, options: argparse.Namespace) -> dict[str, Any]:
    """The figures for one standard deviation; what is there is not run again."""
    folder = options.out / f"{1e3 * sigma:g}_mm"
    kept = folder / ROW_FILE
    if kept.is_file():
        row: dict[str, Any] = json.loads(kept.read_text(encoding="utf-8"))
        return row
    row = explore(sigma, folder, options)
    write_json(kept, row)
    return row


def explore(sigma: float, folder: Path, options: argparse.Namespace) -> dict[str, Any]:
    """Explore the world once."""
    settings = [f"world.name={options.world}", f"world.seed={options.seed}"]
    settings += [f"world.size={options.size}", f"task.max_views={options.max_views}"]
    settings += [f"task.surface_sigma={sigma}", f"task.known_fraction={options.known_fraction}"]
    run = ExplorationRun(with_settings(ExplorationOptions(), settings + options.set), folder)
    figures = run.write_results(run.run())
    run.close()
    decisions = read_run(folder / LOG_FILE).of(Decision)
    poses = np.array([each.pose for each in decisions if each.pose is not None])
    reach = run.options.planner.max_range
    across, down = (grid.ravel() for grid in np.meshgrid(_SPREAD, _SPREAD))
    rays = np.stack([across, down, np.ones_like(across)], axis=1)
    ranges = []
    for pose in poses:
        distances, met = run.map.cast_rays(pose[:3, 3], rays @ pose[:3, :3].T, reach)
        ranges.append(float(np.median(distances[met])) if met.any() else None)
    _, _, covariances = run.map.gaussians()
    sigmas = surface_sigmas(covariances)
    return figures | {
        "asked_sigma": sigma,
        "poses": poses.tolist(),
        "ranges": ranges,
        "median_sigma": float(np.median(sigmas)),
        "sigma_90": float(np.quantile(sigmas, 0.9)),
    }


def ranges_of(row: dict[str, Any]) -> np.ndarray:
    """Median distances of what the views look at [m]."""
    return np.array([each for each in row["ranges"] if each is not None])


def print_table(rows: list[dict[str, Any]]) -> None:
    """One row per standard deviation."""
    print(
        "| asked | end | views | driven | known | precisely enough | looks from "
        "| sigma: median, 90 % | true coverage | within 1 / 2 / 3 sigma |"
    )
    print("|" + " --- |" * 10)
    for row in rows:
        within = " / ".join(f"{100 * row[f'within_{n}_sigma']:.0f}" for n in (1, 2, 3))
        print(
            f"| {1e3 * row['asked_sigma']:g} mm | {row['end']} | {row['views']} "
            f"| {row['distance']} m | {100 * row['known_fraction']:.1f} % "
            f"| {100 * row['precise_fraction']:.1f} % | {np.median(ranges_of(row)):.2f} m "
            f"| {1e3 * row['median_sigma']:.1f}, {1e3 * row['sigma_90']:.1f} mm "
            f"| {100 * row['true_coverage']:.1f} % | {within} % |"
        )


def draw(rows: list[dict[str, Any]], path: Path) -> None:
    """Views from above, and a histogram of what they look from, a column per deviation."""
    figure, axes = plt.subplots(
        2, len(rows), figsize=(4.2 * len(rows), 6.4), squeeze=False, sharex="row", sharey="row"
    )
    for column, row in zip(axes.T, rows, strict=True):
        poses = np.array(row["poses"])
        place, look = poses[:, :2, 3], poses[:, :2, 2]
        above, histogram = column
        above.quiver(*place.T, *look.T, np.arange(len(poses)), cmap="viridis", scale=12, width=0.01)
        above.set_aspect("equal")
        above.set_title(f"{1e3 * row['asked_sigma']:g} mm asked: {len(poses)} views")
        above.set_xlabel("x, map [m]")
        histogram.hist(ranges_of(row), bins=np.arange(0.0, 4.01, 0.25), color="tab:blue")
        histogram.set_xlabel("median distance of what a view looks at [m]")
    axes[0, 0].set_ylabel("y, map [m]")
    axes[1, 0].set_ylabel("views")
    figure.tight_layout()
    save_figure(figure, path, 110)


def main() -> None:
    """Explore for each standard deviation, and show them side by side."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--sigmas", type=float, nargs="+", default=[0.03, 0.01, 0.005])
    parser.add_argument("--world", default="mars")
    parser.add_argument("--seed", type=int, default=2)
    parser.add_argument("--size", type=float, default=4.5)
    parser.add_argument("--known-fraction", type=float, default=0.9)
    parser.add_argument("--max-views", type=int, default=40)
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--set", nargs="*", default=[], metavar="NAME=VALUE")
    options = parser.parse_args()
    with ProcessPoolExecutor(options.jobs) as pool:
        rows = list(pool.map(partial(kept_or_new, options=options), options.sigmas))
    for row in rows:
        print(json.dumps({k: v for k, v in row.items() if k not in ("poses", "ranges")}))
    print_table(rows)
    draw(rows, options.out / "surface_precision.png")


if __name__ == "__main__":
    main()
