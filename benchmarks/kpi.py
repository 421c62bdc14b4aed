"""The figures of a release: real cameras in real places, with default settings only.

Localization on all sequences beside a smoother of GTSAM and PnP from frame to frame; range on pairs
with true disparity beside the plain matcher; a map of a real room against frames that were left out
of it. Prints one JSON line; with `--write` also docs/results/kpi.md.

    python benchmarks/kpi.py [--data FOLDER] [--work FOLDER] [--write]
        [--only {localization,map}]

Real data are looked for in `--data` (default: INFOMAP_DATA or ../shared/data); what is absent is
named and left out.
"""

from __future__ import annotations

import argparse
import datetime
import json
import os
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from given_landmarks import landmark_rows, landmark_section
from localize_sequences import ROOT, SEQUENCES, add_folders, bag_of, compare, views_of
from trajectory_errors import truth_at

import infomap_ros
from infomap_ros.errors import InfomapError
from infomap_ros.geometry import PoseRecord, transform_points
from infomap_ros.geometry.atomic_file import write_text
from infomap_ros.mapping import VoxelMap, VoxelMapConfig
from infomap_ros.replay.bags.reader import BagReader
from infomap_ros.replay.localize_run import LocalizeOptions
from infomap_ros.stereo import StereoConfig
from infomap_ros.stereo.evaluation import load_pairs, measure_errors
from infomap_ros.stereo.range_cloud import RangeCloud

PAGE = ROOT / "docs" / "results" / "kpi.md"
PAIRS = ("stereo_motorcycle", "stereo_opencv_samples")
ROOM = "rgbd_kitchen"
PEERS = ["klt_gtsam", "klt_pnp", "orb_pnp"]
LEFT_OUT = 10  # every so many frames one is not mapped
EVERY = 31  # pixel of such a frame is compared
SIZES = (0.05, 0.03)  # of voxels, the default first [m]
NEIGHBORS = np.array(np.meshgrid(*[(-1, 0, 1)] * 3)).reshape(3, -1).T
LOCALIZATION_TITLE, MAP_TITLE = "## Localization", "## Map"
Row = dict[str, Any]


def localization(data: Path, work: Path, absent: list[str]) -> list[Row]:
    """Errors on each sequence, of this package and of peers on the same frames."""
    rows = []
    for name, sequence in SEQUENCES.items():
        bag = bag_of(sequence, data, work)
        if bag is None:
            absent.append(name)
            continue
        for method, figures in compare(bag, sequence, PEERS).items():
            meters = float(figures["delta"])
            rows.append(
                {
                    "sequence": name,
                    "method": method,
                    "views": int(figures["views"]),
                    "not_located": int(figures["not_located"]),
                    "ape_mm": 1e3 * figures["ape"],
                    "translation_percent": figures["rpe_percent"],
                    "rotation_deg_per_m": figures["rpe_degrees"] / meters,
                    "nees_median": figures.get("nees_median"),
                    "nees_mean": figures.get("nees_mean"),
                    "frames_per_second": figures["views"] / figures["seconds"],
                }
            )
    return rows


def nees_text(row: Row) -> str:
    """Median and mean; empty for a method that gives no covariance."""
    if row["nees_median"] is None:
        return ""
    return f"{row['nees_median']:.2f}, {row['nees_mean']:.2f}"


def stereo_range(data: Path, absent: list[str]) -> list[Row]:
    """Density, bad pixels and honesty of the range on pairs with truth."""
    rows = []
    for folder in PAIRS:
        try:
            pairs = load_pairs(data / folder)
        except InfomapError:
            absent.append(folder)
            continue
        for pair in pairs:
            errors = measure_errors(pair, StereoConfig())
            rows.append(
                {
                    "pair": pair.name,
                    "density": errors.density,
                    "bad": errors.bad,
                    "plain_density": errors.plain_density,
                    "plain_bad": errors.plain_bad,
                    "within": errors.shares(),
                    "within_exact_truth": errors.shares(with_truth_sigma=False),
                }
            )
    return rows


def room(data: Path, work: Path, absent: list[str]) -> list[Row]:
    """Maps from true poses, against frames that are not in them."""
    path = bag_of(SEQUENCES[ROOM], data, work)
    if path is None:
        absent.append(f"{ROOM}, map")
        return []
    maps = [VoxelMap(VoxelMapConfig(voxel_size=size)) for size in SIZES]
    kept, fused, seconds = [], 0, dict.fromkeys(SIZES, 0.0)
    for number, cloud, pose in placed_clouds(path):
        if number % LEFT_OUT == LEFT_OUT // 2:
            kept.append((cloud.points[::EVERY].astype(float), pose))
            continue
        if fused == 0:  # compiled and warm
            scan = cloud.organized_points, pose, cloud.organized_covariances
            VoxelMap().integrate(*scan, camera=cloud.camera)
        fused += 1
        for voxel_map in maps:
            begin = time.perf_counter()
            voxel_map.integrate(
                cloud.organized_points,
                pose,
                cloud.organized_covariances,
                camera=cloud.camera,
                error_correlation=cloud.error_correlation,
            )
            seconds[voxel_map.config.voxel_size] += time.perf_counter() - begin
    return [
        _compared(voxel_map, kept) | {"fused_per_second": fused / seconds[size]}
        for voxel_map, size in zip(maps, SIZES, strict=True)
    ]


def placed_clouds(path: Path) -> Iterator[tuple[int, RangeCloud, np.ndarray]]:
    """Number, cloud and true T_map_camera of each frame of the room whose pose is known."""
    with BagReader(path) as bag:
        records = [entry.record for entry in bag.records([SEQUENCES[ROOM].truth])]
        poses = [record for record in records if isinstance(record, PoseRecord)]
    with BagReader(path) as bag:
        for number, view in enumerate(views_of(bag, LocalizeOptions())):
            known, truth = truth_at(poses, [view.stamp])
            if known[0]:
                yield number, view.cloud(), truth[0]


def _compared(voxel_map: VoxelMap, kept: list[tuple[np.ndarray, np.ndarray]]) -> Row:
    compared = [against(voxel_map, points, pose) for points, pose in kept]
    surface, faces, occupied, free = (
        np.concatenate([each[n] for each in compared]) for n in range(4)
    )
    met = np.isfinite(surface)
    return {
        "frames": len(kept),
        "voxel_size": voxel_map.config.voxel_size,
        "surface_voxels": voxel_map.surface_voxels,
        "met": float(met.mean()),
        "bias_mm": 1e3 * float(np.median(surface[met])),
        "median_mm": 1e3 * float(np.median(np.abs(surface[met]))),
        "error_90_mm": 1e3 * float(np.quantile(np.abs(surface[met]), 0.9)),
        "faces_mm": 1e3 * float(np.nanmedian(faces)),
        "faces_90_mm": 1e3 * float(np.nanquantile(np.abs(faces), 0.9)),
        "occupied_recall": float(occupied.mean()),
        "free_recall": float(free.mean()),
    }


def against(
    voxel_map: VoxelMap, points: np.ndarray, pose: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """One frame that was left out against the map.

    Returns:
        How much farther than each measurement its ray meets the surface, and how much farther it
        enters an occupied voxel, NaN where it does not [m]; of each point, whether a voxel of the
        27 about it is occupied; and of each place half way to a point, whether it is known to be
        free.
    """
    config, origin = voxel_map.config, pose[:3, 3]
    distances = np.linalg.norm(points, axis=1)
    points, distances = (
        points[distances < config.max_range],
        distances[distances < config.max_range],
    )
    there = transform_points(pose, points)
    surface, _ = voxel_map.surface_along(origin, there - origin, config.max_range)
    faces, entered = voxel_map.first_occupied(origin, there - origin, config.max_range)
    faces = np.where(entered, faces, np.nan)
    around = there[:, None, :] + config.voxel_size * NEIGHBORS
    occupied = voxel_map.log_odds(around.reshape(-1, 3)).reshape(len(there), -1) > 0.0
    half = 0.5 * (there + origin)
    free = np.logical_and(voxel_map.is_known(half), voxel_map.log_odds(half) < 0.0)
    return surface - distances, faces - distances, np.asarray(occupied.any(axis=1)), free


def percents(shares: Sequence[float]) -> str:
    return " / ".join(f"{100 * share:.0f}" for share in shares)


def page(figures: Row) -> str:
    """The figures as Markdown."""
    lines = [
        "# Figures of a release",
        "",
        "Real cameras in real places, with default settings only; data that are not part of the "
        "package. Made by",
        "",
        "    make kpi",
        "",
        f"with version {figures['version']} on {figures['date']}, in {figures['minutes']:.0f} "
        f"minutes on {os.cpu_count()} cores. Absent: {', '.join(figures['absent']) or 'nothing'}.",
        "",
        *localization_section(figures["localization"]),
        *landmark_section(figures["landmarks"]),
        "## Range",
        "",
        "Density: measured pixels of those with a truth; bad: off by more than 3 px. Within 1, 2, "
        "3 sigma: of the others, the truth's own error added, and with the truth taken as exact.",
        "",
        "| pair | density | bad | plain matcher: density | bad "
        "| within 1 / 2 / 3 sigma [%] | truth as exact [%] |",
        "|" + " --- |" * 7,
    ]
    lines += [
        f"| {row['pair']} | {row['density']:.1%} | {row['bad']:.2%} | {row['plain_density']:.1%} "
        f"| {row['plain_bad']:.2%} | {percents(row['within'])} "
        f"| {percents(row['within_exact_truth'])} |"
        for row in figures["range"]
    ]
    return "\n".join([*lines, "", *map_section(figures["room"])])


def localization_section(rows: list[Row]) -> list[str]:
    """Errors of localization and of its peers, as lines of Markdown."""
    return [
        LOCALIZATION_TITLE,
        "",
        "Errors over pieces of the path as evo takes them ([sequences and peers]"
        "(localization.md)). Peers get the same images, and ranges where they ask for them: a "
        "fixed-lag smoother of GTSAM on corners followed by KLT, and KLT and ORB with PnP from "
        "image to image. By the calibration of stereo_kitti_curve disparities are about 1 px too "
        "small.",
        "",
        "NEES/6: squared errors of the poses by their covariances and that of the truth, median "
        "and mean over the views; 1 where sigmas are true, smaller where they are too large. The "
        "cameras of rover_rocks and room loop are simulated and exact, while sigmas hold the error "
        "of [disparity](../localization.md) that a calibrated camera is expected to have.",
        "",
        "| sequence | method | views | not located | APE [mm] | translation [%] "
        "| rotation [deg/m] | NEES/6 median, mean | frames/s |",
        "|" + " --- |" * 9,
        *(
            f"| {row['sequence']} | {row['method']} | {row['views']} | {row['not_located']} "
            f"| {row['ape_mm']:.1f} | {row['translation_percent']:.2f} "
            f"| {row['rotation_deg_per_m']:.3f} | {nees_text(row)} "
            f"| {row['frames_per_second']:.1f} |"
            for row in rows
        ),
        "",
    ]


def map_section(rows: list[Row]) -> list[str]:
    """The figures of the map, as lines of Markdown; none without any."""
    if not rows:
        return []
    return [
        MAP_TITLE,
        "",
        f"`{ROOM}`, a depth camera in a real kitchen, with the poses that come with it; every "
        f"{LEFT_OUT}th frame is left out and compared with the map. A ray of such a frame meets "
        "the surface where `VoxelMap.cast_rays` says, and the first occupied voxel at its face "
        "(`first_occupied`).",
        "",
        "| voxels | surface voxels | rays that meet the surface | they meet it off by: bias, "
        "median, 90 % | the first occupied voxel: bias, 90 % | points with an occupied voxel "
        "within one | half-way places known free | scans/s |",
        "|" + " --- |" * 8,
        *(
            f"| {1e3 * row['voxel_size']:.0f} mm | {row['surface_voxels']:,} | {row['met']:.1%} "
            f"| {row['bias_mm']:+.1f}, {row['median_mm']:.1f}, {row['error_90_mm']:.0f} mm "
            f"| {row['faces_mm']:+.0f}, {row['faces_90_mm']:.0f} mm "
            f"| {row['occupied_recall']:.1%} | {row['free_recall']:.1%} "
            f"| {row['fused_per_second']:.1f} |"
            for row in rows
        ),
        "",
    ]


def with_section(text: str, part: str, rows: list[Row]) -> str:
    """A page with the figures of one part made anew."""
    title, *rest = (localization_section if part == "localization" else map_section)(rows)
    made = (
        f"This section was made alone, by `python benchmarks/kpi.py --only {part} --write` with "
        f"version {infomap_ros.__version__} on {datetime.date.today().isoformat()}."
    )
    before, after = text.split(f"{title}\n", 1)
    following = after.find("\n## ")
    kept = "" if following < 0 else after[following:]
    return before + "\n".join([title, "", made, *rest]) + kept


def main() -> None:
    """Measure all of it."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    add_folders(parser)
    parser.add_argument("--write", action="store_true", help="docs/results/kpi.md")
    parser.add_argument("--only", choices=("localization", "map"), help="a part of it")
    arguments = parser.parse_args()
    arguments.work.mkdir(parents=True, exist_ok=True)
    begin, absent = time.monotonic(), list[str]()
    figures: Row = {"benchmark": "kpi", "version": infomap_ros.__version__}
    figures["date"] = datetime.date.today().isoformat()
    if arguments.only is not None:
        measure = localization if arguments.only == "localization" else room
        rows = measure(arguments.data, arguments.work, absent)
        print(json.dumps(figures | {arguments.only: rows, "absent": absent}))
        if arguments.write and rows:
            write_text(PAGE, with_section(PAGE.read_text("utf-8"), arguments.only, rows))
        return
    figures["localization"] = localization(arguments.data, arguments.work, absent)
    figures["landmarks"] = landmark_rows(arguments.data, absent)
    figures["range"] = stereo_range(arguments.data, absent)
    figures["room"] = room(arguments.data, arguments.work, absent)
    figures |= {"absent": absent, "minutes": (time.monotonic() - begin) / 60.0}
    print(json.dumps(figures))
    if arguments.write:
        write_text(PAGE, page(figures))
    else:
        print(page(figures))


if __name__ == "__main__":
    main()
