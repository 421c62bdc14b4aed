"""Moving scans after their poses were corrected: memory, time, and what becomes of the ghosts.

The bag that comes with the package is mapped with poses that drift away from the recorded ones, as
odometry does; then all poses are corrected and the map is made again. Surface voxels are compared
with the scene, whose surface is known exactly. One JSON line, and with --figure a picture.

    python benchmarks/bench_reintegration.py --figure docs/figures/reintegration.png
"""

from __future__ import annotations

import argparse
import json
import statistics
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from infomap_ros.geometry import make_transform, perturb_transform
from infomap_ros.geometry.atomic_file import save_figure
from infomap_ros.geometry.resources import find_share
from infomap_ros.mapping import VoxelMap, VoxelMapConfig
from infomap_ros.mapping.correction.reintegration import Reintegration, moved_scans
from infomap_ros.mapping.correction.scan_record import keep_scan
from infomap_ros.mapping.correction.scan_store import ScanStore, integrate_record
from infomap_ros.pipeline.pipeline import Fused
from infomap_ros.replay.bags.reader import BagReader
from infomap_ros.replay.map_run import MapRun
from infomap_ros.simulation.worlds.scenes import build_scene

BAG = "bags/rover_rocks"
DRIFT = np.array([0.0, 0.25, 0.12, 0.0, 0.0, 0.10])  # at the end of the bag [m, rad]
NEAR = 0.1  # a surface voxel farther from the surface than this is a ghost [m]


class Frame(NamedTuple):
    """One scan of the bag."""

    stamp: int
    points: np.ndarray
    covariances: np.ndarray
    camera: Any
    correlation: float
    pose: np.ndarray
    uncertainty: np.ndarray


def frames_of(path: Path) -> list[Frame]:
    """All scans of the bag, without the robot's body."""
    frames = []
    with BagReader(path) as bag:
        run = MapRun(bag)
        for done in run.results():
            if not isinstance(done, Fused):
                continue
            cloud, pose = done.scan.cloud.cloud, done.scan.pose
            points = run.builder.without_bodies(done.scan.cloud.record, done.scan)
            covariance = pose.covariance if pose.covariance is not None else np.eye(6) * 1e-6
            frames.append(
                Frame(
                    done.scan.cloud.stamp,
                    points,
                    cloud.covariance_triangles,
                    cloud.camera,
                    cloud.error_correlation,
                    pose.transform,
                    covariance,
                )
            )
    return frames


def scene_of(path: Path) -> Any:
    """The world in which the bag was recorded."""
    with BagReader(path) as bag:
        entry = next(iter(bag.records(["/ground_truth/scene"])))
    return build_scene(entry.record.text)


def map_with_drift(frames: list[Frame], config: VoxelMapConfig) -> tuple[VoxelMap, ScanStore]:
    """The map, and its scans, from poses that drift away in proportion to time."""
    voxel_map, store = VoxelMap(config), ScanStore(config)
    voxel_map.track_changes(True)
    for number, frame in enumerate(frames):
        pose = perturb_transform(frame.pose, DRIFT * number / (len(frames) - 1))
        store.integrate(
            voxel_map, frame.stamp, frame.points, pose, frame.covariances,
            frame.uncertainty, frame.camera, frame.correlation,
        )  # fmt: skip
    return voxel_map, store


def share_of_ghosts(voxel_map: VoxelMap, scene: Any) -> tuple[int, float]:
    """Number of surface voxels, and the share of them that is far from the true surface."""
    _, means, _ = voxel_map.gaussians()
    return len(means), float(np.mean(np.abs(scene.surface.distance(means)) > NEAR))


def seconds(action: Callable[[], object], times: int) -> float:
    """Median time of an action [s]."""
    taken = []
    for _ in range(times):
        start = time.perf_counter()
        action()
        taken.append(time.perf_counter() - start)
    return statistics.median(taken)


def draw(path: Path, maps: dict[str, VoxelMap]) -> None:
    """Surface voxels of each map from above, colored by height."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(4.6 * len(maps), 4.4), layout="constrained")
    for axes, (title, voxel_map) in zip(
        figure.subplots(1, len(maps), sharex=True, sharey=True), maps.items(), strict=True
    ):
        _, means, _ = voxel_map.gaussians()
        inside = (means[:, 2] > 0.08) & (means[:, 2] < 1.0)
        places = means[inside]
        places = places[np.argsort(places[:, 2])]
        axes.scatter(places[:, 0], places[:, 1], c=places[:, 2], s=1.2, cmap="viridis", lw=0)
        axes.set(title=title, xlabel="x [m]", aspect="equal", xlim=(0.0, 6.5), ylim=(-3.2, 3.2))
    figure.supylabel("y [m]", fontsize=10)
    path.parent.mkdir(parents=True, exist_ok=True)
    save_figure(figure, path, 110)


def measure(voxel_size: float, figure: Path | None) -> dict[str, float | int]:
    """Everything, for one voxel size."""
    bag = find_share(BAG)
    frames, scene = frames_of(bag), scene_of(bag)
    config = VoxelMapConfig(voxel_size=voxel_size)
    map_with_drift(frames[:2], config)  # compile
    voxel_map, store = map_with_drift(frames, config)
    before = VoxelMap.from_state(config, voxel_map.state())
    poses = {(frame.stamp, ""): (frame.pose, frame.uncertainty) for frame in frames}
    first, some = frames[0], list(store)[len(frames) // 2]
    start = time.perf_counter()
    moved = moved_scans(store, poses, voxel_map)
    report = Reintegration(voxel_map, store, moved).finish()
    taken = time.perf_counter() - start
    last = {store_scan.key: poses[store_scan.key] for store_scan in list(store)[-1:]}
    shifted = {s: (p @ make_transform(np.eye(3), [0.1, 0, 0]), c) for s, (p, c) in last.items()}
    start = time.perf_counter()
    one = Reintegration(voxel_map, store, moved_scans(store, shifted, voxel_map)).finish()
    taken_by_one = time.perf_counter() - start
    Reintegration(voxel_map, store, moved_scans(store, last, voxel_map)).finish()
    fresh = VoxelMap(config)
    start = time.perf_counter()
    for scan in store:
        integrate_record(fresh, scan.record, scan.transform, scan.uncertainty)
    anew = time.perf_counter() - start
    ghosts_before, ghosts_after = share_of_ghosts(before, scene), share_of_ghosts(voxel_map, scene)
    if figure is not None:
        draw(figure, {"poses that drift": before, "the same scans, poses corrected": voxel_map})
    raw = first.points.nbytes + first.covariances.nbytes
    return {
        "voxel_size": voxel_size,
        "scans": len(frames),
        "pixels": int(first.points.shape[0] * first.points.shape[1]),
        "record_kB": round(statistics.mean(s.record.memory_bytes() for s in store) / 1e3, 1),
        "cloud_kB": round(raw / 1e3, 1),
        "keep_ms": round(1e3 * seconds(lambda: keep_scan(*first[1:5]), 15), 1),
        "restore_ms": round(1e3 * seconds(some.record.restore, 15), 1),
        "moved": report.scans_moved,
        "reintegration_s": round(taken, 3),
        "made_anew_s": round(anew, 3),
        "one_moved_integrated": one.scans_integrated,
        "one_moved_s": round(taken_by_one, 3),
        "largest_correction_m": round(report.largest_correction, 3),
        "surface_voxels_before": ghosts_before[0],
        "ghosts_before": round(ghosts_before[1], 4),
        "surface_voxels_after": ghosts_after[0],
        "ghosts_after": round(ghosts_after[1], 4),
        "map_bytes": voxel_map.memory_bytes(),
    }


def main() -> None:
    """Print one line for each voxel size."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--voxel-sizes", type=float, nargs="+", default=[0.05])
    parser.add_argument("--figure", type=Path)
    options = parser.parse_args()
    for size in options.voxel_sizes:
        print(json.dumps(measure(size, options.figure)), flush=True)


if __name__ == "__main__":
    main()
