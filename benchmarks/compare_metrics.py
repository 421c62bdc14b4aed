"""What a robot that could jump would map, choosing each view by one metric; one JSON line each.

In the room of `room.py`, from a random first view, each next view is the best of 80 random ones
whose camera stands in known free space. Reported is the share of the room's surface and of its free
space (all that 150 random scans find) that is known after so many views, the mean over seeds.
Nothing but the metric decides: no way, no arm, no rating.

    python benchmarks/compare_metrics.py [--seeds 3] [--views 24] [--metrics NAME ...]
        [--known-weight W] [--unknown-occlusion P]
"""

from __future__ import annotations

import argparse
import json
import time
from dataclasses import dataclass, replace

import numpy as np
import room

from infomap_ros.geometry import PinholeCamera, make_transform
from infomap_ros.mapping import VoxelMap, VoxelMapConfig
from infomap_ros.studies.published_metrics import EVERY_METRIC
from infomap_ros.views.information.view_information import expected_information
from infomap_ros.views.information.view_query import InformationConfig

CAMERA = PinholeCamera(128, 96, 105.0, 105.0, 63.5, 47.5)
GRID = VoxelMapConfig(voxel_size=0.1, max_range=4.0)
REGION = np.array([[-5.2, -5.2, -0.5], [5.2, 5.2, 3.2]])
POSE_COVARIANCE = np.diag([1e-6, 1e-6, 1e-6, 1e-7, 1e-7, 1e-7])
CONFIG = InformationConfig(ray_spacing=0.04, min_range=0.2, range_noise=0.0038)
CANDIDATES, REPORT_EVERY = 80, 4


@dataclass(frozen=True, eq=False)
class Truth:
    """Middles of the voxels that can be seen, shape (n, 3) [m]."""

    surface: np.ndarray
    free: np.ndarray


def random_views(rng: np.random.Generator, count: int, known: VoxelMap | None) -> np.ndarray:
    """Poses (count, 4, 4) outside the boxes and, with a map, in its free space."""
    poses: list[np.ndarray] = []
    while len(poses) < count:
        places = rng.uniform((-4.6, -4.6, 0.4), (4.6, 4.6, 1.8), (4000, 3))
        good = np.ones(len(places), np.bool_)
        for low, high in room.boxes():
            good &= ~((places > low - 0.15) & (places < high + 0.15)).all(axis=1)
        if known is not None:
            good &= known.is_known(places) & (known.probability(places) < 0.3)
        poses.extend(_looking(rng, place) for place in places[good][: count - len(poses)])
    return np.array(poses)


def _looking(rng: np.random.Generator, place: np.ndarray) -> np.ndarray:
    yaw, pitch = rng.uniform(0.0, 2.0 * np.pi), rng.uniform(-0.1, 0.7)
    forward = np.array([np.cos(yaw) * np.cos(pitch), np.sin(yaw) * np.cos(pitch), -np.sin(pitch)])
    right = np.cross(forward, [0.0, 0.0, 1.0]) / np.cos(pitch)
    return make_transform(np.stack([right, np.cross(forward, right), forward], axis=1), place)


def scan(voxel_map: VoxelMap, pose: np.ndarray) -> None:
    """Integrate what the camera sees, with noise as of a stereo pair but without its errors."""
    points = room.cloud(pose, CAMERA)
    voxel_map.integrate(points, pose, room.covariances(points), POSE_COVARIANCE, CAMERA)


def true_room() -> Truth:
    """What 150 random scans find."""
    voxel_map, rng = VoxelMap(GRID), np.random.default_rng(99)
    for pose in random_views(rng, 150, None):
        scan(voxel_map, pose)
    indices, log_odds = voxel_map.voxels()
    centers = (indices + 0.5) * GRID.voxel_size
    return Truth(centers[log_odds > 1.0], centers[log_odds < -2.0])


def explored(
    metric: str, seed: int, views: int, truth: Truth, config: InformationConfig
) -> np.ndarray:
    """Known share of surface and free space after every few views, shape (n, 2)."""
    voxel_map, rng, shares = VoxelMap(GRID), np.random.default_rng(seed), []
    scan(voxel_map, random_views(rng, 1, None)[0])
    for view in range(1, views + 1):
        poses, chosen = random_views(rng, CANDIDATES, voxel_map), 0
        if metric != "random":
            rated_by = EVERY_METRIC[metric]
            bits = expected_information(voxel_map, poses, CAMERA, 4.0, rated_by, config, REGION)
            chosen = int(bits.argmax())
        scan(voxel_map, poses[chosen])
        if view % REPORT_EVERY == 0:
            surface = (voxel_map.probability(truth.surface) > 0.5).mean()
            shares.append((surface, voxel_map.is_known(truth.free).mean()))
    return np.array(shares)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--views", type=int, default=24)
    parser.add_argument("--metrics", nargs="+", default=[*EVERY_METRIC, "random"])
    parser.add_argument("--known-weight", type=float, default=CONFIG.known_weight)
    parser.add_argument("--unknown-occlusion", type=float, default=CONFIG.unknown_occlusion)
    arguments, truth = parser.parse_args(), true_room()
    config = replace(
        CONFIG,
        known_weight=arguments.known_weight,
        unknown_occlusion=arguments.unknown_occlusion,
    )
    for metric in arguments.metrics:
        start = time.process_time()
        seeds = range(arguments.seeds)
        runs = [explored(metric, seed, arguments.views, truth, config) for seed in seeds]
        mean = np.mean(runs, axis=0)
        figures = {
            "benchmark": "compare_metrics",
            "metric": metric,
            "seeds": arguments.seeds,
            "known_weight": config.known_weight,
            "unknown_occlusion": config.unknown_occlusion,
            "after_views": list(range(REPORT_EVERY, arguments.views + 1, REPORT_EVERY)),
            "surface": mean[:, 0].round(3).tolist(),
            "free_space": mean[:, 1].round(3).tolist(),
            "seconds": round(time.process_time() - start, 1),
        }
        print(json.dumps(figures), flush=True)


if __name__ == "__main__":
    main()
