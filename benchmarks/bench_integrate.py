"""Integrating one scan, beside OctoMap on the same clouds in the same run; one JSON line.

640x480 organized clouds of the room in `room.py`, 5 m range, everything included: occupancy, one
Gaussian per surface voxel, pose covariance. OctoMap (pyoctomap) gets the points in the map frame,
so that turning them is not on its bill, and holds occupancy alone; `insert` is insertPointCloud
ray by ray on one thread, `discretized` merges the rays of one end voxel and leaves the inner nodes
alone. `bare` is the least that a map with Gaussians has to do with the same cloud, and no map: a
loop that reads each point with its covariance, turns it, and adds both to a row of its voxel. What
two threads bring to it, half of the points each, is what this machine gives to two threads at the
time. Other processes that want the cores take them from the second thread above all; with
``chrt -f 10`` before the command it does not wait for them.

    python benchmarks/bench_integrate.py [--poses 20] [--peer-poses 20 3] [--voxel-sizes 0.05 0.02]
"""

from __future__ import annotations

import argparse
import gc
import json
import os
import statistics
import sys
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import room
from numba import njit

from infomap_ros.geometry import transform_points
from infomap_ros.mapping import VoxelMap, VoxelMapConfig
from infomap_ros.mapping.scans.workers import Workers
from infomap_ros.mapping.voxels.keys import BLOCK_COUNT, block_bytes
from infomap_ros.mapping.voxels.surface import surface_bytes

os.environ["OMP_NUM_THREADS"] = "1"  # OctoMap traces rays on all cores otherwise
try:
    import pyoctomap
except ImportError:
    sys.exit("bench_integrate needs the peer it measures against: pip install 'pyoctomap>=1.2'")

MAX_RANGE = 5.0
POSE_COVARIANCE = np.diag([1e-4, 1e-4, 1e-4, 1e-5, 1e-5, 1e-5])

Frame = tuple[np.ndarray, np.ndarray, np.ndarray]


def depth_camera_covariances(points: np.ndarray) -> np.ndarray:
    """Covariances (H, W, 6), float32 [m^2]: range sigma of a structured-light camera.

    Along the ray 1.2 mm + 1.9 mm (z - 0.4)^2 (doi:10.1109/3DIMPVT.2012.84), across it 0.8 px.
    """
    z = points[..., 2].astype(np.float64)
    along = 0.0012 + 0.0019 * (z - 0.4) ** 2
    ray = points / points[..., 2:3]
    across = (0.8 * z / room.CAMERA.fx) ** 2
    full = ray[..., :, None] * ray[..., None, :] * (along**2)[..., None, None]
    full = full + across[..., None, None] * np.eye(3)
    rows, columns = np.triu_indices(3)
    return full[..., rows, columns].astype(np.float32)


class Times(NamedTuple):
    """What calls took, one entry each [ms]; other processes disturb processor time less."""

    wall: list[float]
    processor: list[float]

    def add(self, task: Callable[[], Any]) -> None:
        """Call and note how long it took."""
        wall, processor = time.perf_counter(), time.process_time()
        task()
        self.processor.append(1e3 * (time.process_time() - processor))
        self.wall.append(1e3 * (time.perf_counter() - wall))


def resident_bytes() -> int:
    """Memory of this process that is in use [bytes]."""
    pages = Path("/proc/self/statm").read_text().split()[1]
    return int(pages) * os.sysconf("SC_PAGE_SIZE")


def integrate_all(frames: list[Frame], size: float, threads: int) -> tuple[VoxelMap, Times]:
    """Integrate all frames into a new map; a frame is points, pose and covariances."""
    config = VoxelMapConfig(voxel_size=size, max_range=MAX_RANGE, threads=threads)
    VoxelMap(config).integrate(*frames[0], POSE_COVARIANCE, room.CAMERA)  # compiled and warm
    voxel_map, times = VoxelMap(config), Times([], [])
    for frame in frames:
        times.add(partial(voxel_map.integrate, *frame, POSE_COVARIANCE, room.CAMERA))
    return voxel_map, times


def insert_all(frames: list[Frame], size: float, merged: bool) -> tuple[Any, Times]:
    """Insert all frames into a new OctoMap."""
    tree, times = pyoctomap.OcTree(size), Times([], [])
    for points, pose, _ in frames:
        cloud = transform_points(pose, points.reshape(-1, 3))
        insert = partial(tree.insertPointCloud, cloud, pose[:3, 3].copy(), MAX_RANGE)
        times.add(partial(insert, lazy_eval=merged, discretize=merged))
    return tree, times


@njit(cache=True, nogil=True, error_model="numpy")
def add_bare(points: Any, covariances: Any, pose: Any, size: float, sums: Any) -> None:
    """Add points and covariances to the rows of their voxels, whoever else has the row.

    Args:
        points: shape (n, 3), float32, sensor frame [m].
        covariances: shape (n, 9), float32 [m^2].
        pose: T_map_sensor.
        size: of a voxel [m].
        sums: shape (2^16, 10), float32.
    """
    scale = 1.0 / size
    for n in range(len(points)):
        x, y, z = np.float64(points[n, 0]), np.float64(points[n, 1]), np.float64(points[n, 2])
        if not x * x + y * y + z * z <= MAX_RANGE**2:
            continue
        mx = (pose[0, 0] * x + pose[0, 1] * y + pose[0, 2] * z + pose[0, 3]) * scale
        my = (pose[1, 0] * x + pose[1, 1] * y + pose[1, 2] * z + pose[1, 3]) * scale
        mz = (pose[2, 0] * x + pose[2, 1] * y + pose[2, 2] * z + pose[2, 3]) * scale
        i, j, k = np.floor(mx), np.floor(my), np.floor(mz)
        row = (np.int64(i) + 256 * np.int64(j) + 7919 * np.int64(k)) & 0xFFFF
        sums[row, 0] += 1.0
        sums[row, 1] += mx - i
        sums[row, 2] += my - j
        sums[row, 3] += mz - k
        for place, column in enumerate((0, 1, 2, 4, 5, 8)):
            sums[row, 4 + place] += covariances[n, column]


def add_all_bare(frames: list[Frame], size: float, threads: int) -> Times:
    """Times of `add_bare` for all frames, the points and their rows divided among threads."""
    times, workers = Times([], []), Workers(threads)
    sums = np.zeros((threads, 1 << 16, 10), np.float32)
    for points, pose, covariances in [frames[0], *frames]:
        flat, table = points.reshape(-1, 3), covariances.reshape(-1, 9)
        task = partial(add_part_bare, flat, table, pose, size, sums)
        times.add(partial(workers.run, task, len(flat)))
    return Times(times.wall[1:], times.processor[1:])


def add_part_bare(
    points: np.ndarray,
    covariances: np.ndarray,
    pose: np.ndarray,
    size: float,
    sums: np.ndarray,
    part: int,
    first: int,
    last: int,
) -> None:
    """Let one thread do `add_bare` for the points [first, last)."""
    add_bare(points[first:last], covariances[first:last], pose, size, sums[part])


def memory_figures(voxel_map: VoxelMap) -> dict[str, float]:
    """Bytes per voxel of a map: occupancy and state, and Gaussians."""
    storage = voxel_map._storage
    stored = len(voxel_map.state()["gaussian_owner"])
    gaussians = surface_bytes(storage.gaussians, int(storage.blocks.counts[BLOCK_COUNT]))
    return {
        "known_voxels": voxel_map.known_voxels,
        "surface_voxels": voxel_map.surface_voxels,
        "stored_gaussians": stored,
        "memory_bytes": voxel_map.memory_bytes(),
        "occupancy_bytes_per_known_voxel": block_bytes(storage.blocks) / voxel_map.known_voxels,
        "gaussian_bytes_per_stored_gaussian": gaussians / stored,
        "gaussian_bytes_per_surface_voxel": gaussians / voxel_map.surface_voxels,
    }


def resident_growth(frames: list[Frame], size: float) -> dict[str, float]:
    """What a map says it grows by, and what the process grows by, after the first scan."""
    voxel_map = VoxelMap(VoxelMapConfig(voxel_size=size, max_range=MAX_RANGE))
    voxel_map.integrate(*frames[0], POSE_COVARIANCE, room.CAMERA)
    gc.collect()
    resident, said = resident_bytes(), voxel_map.memory_bytes()
    for frame in frames[1:]:
        voxel_map.integrate(*frame, POSE_COVARIANCE, room.CAMERA)
    gc.collect()
    return {
        "memory_bytes_growth": voxel_map.memory_bytes() - said,
        "resident_growth": resident_bytes() - resident,
    }


def octomap_memory(tree: Any, size: float) -> dict[str, float]:
    """OctoMap's own account, and per voxel of the finest level that it knows."""
    tree.updateInnerOccupancy()
    known = sum(round(leaf.getSize() / size) ** 3 for leaf in tree.begin_leafs())
    return {
        "octomap_bytes": tree.memoryUsage(),
        "octomap_known_voxels": known,
        "octomap_bytes_per_known_voxel": tree.memoryUsage() / known,
    }


def compare(stereo: list[Frame], depth: list[Frame], size: float, peers: int) -> dict[str, Any]:
    """All figures at one voxel size; times are medians [ms]."""
    voxel_map, one = integrate_all(stereo, size, 1)
    two = integrate_all(stereo, size, 2)[1]
    tree, merged = insert_all(stereo[:peers], size, merged=True)
    ray_by_ray = insert_all(stereo[:peers], size, merged=False)[1]
    depth_camera = integrate_all(depth, size, 1)[1]
    bare, bare_two = (add_all_bare(stereo, size, threads) for threads in (1, 2))
    return {
        "voxel_size": size,
        "peer_poses": peers,
        "integrate_ms": statistics.median(one.wall),
        "integrate_2_threads_ms": statistics.median(two.wall),
        "integrate_depth_camera_ms": statistics.median(depth_camera.wall),
        "bare_ms": statistics.median(bare.wall),
        "bare_2_threads_ms": statistics.median(bare_two.wall),
        "bare_processor_ms": statistics.median(bare.processor),
        "octomap_insert_ms": statistics.median(ray_by_ray.wall),
        "octomap_discretized_ms": statistics.median(merged.wall),
        "ratio_to_insert": median_ratio(ray_by_ray.wall, one.wall),
        "ratio_to_discretized": median_ratio(merged.wall, one.wall),
        "ratio_2_threads": median_ratio(one.wall, two.wall),
        "bare_ratio_2_threads": median_ratio(bare.wall, bare_two.wall),
        "integrate_processor_ms": statistics.median(one.processor),
        "processor_ratio_to_insert": median_ratio(ray_by_ray.processor, one.processor),
        "processor_ratio_to_discretized": median_ratio(merged.processor, one.processor),
        **memory_figures(voxel_map),
        **octomap_memory(tree, size),
    }


def median_ratio(slow: list[float], fast: list[float]) -> float:
    """Median of one time divided by the other, over the poses that both have seen."""
    return statistics.median(a / b for a, b in zip(slow, fast, strict=False))


def rounded(figures: dict[str, Any]) -> dict[str, Any]:
    return {k: round(v, 2) if isinstance(v, float) else v for k, v in figures.items()}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--poses", type=int, default=20)
    parser.add_argument("--voxel-sizes", type=float, nargs="+", default=[0.05, 0.02])
    parser.add_argument(
        "--peer-poses", type=int, nargs="+", default=[20, 3], help="per voxel size; OctoMap is slow"
    )
    arguments = parser.parse_args()
    poses = room.poses(arguments.poses)
    clouds = [room.cloud(pose) for pose in poses]
    stereo = [(c, p, room.covariances(c)) for c, p in zip(clouds, poses, strict=True)]
    depth = [(c, p, depth_camera_covariances(c)) for c, p in zip(clouds, poses, strict=True)]
    load = os.getloadavg()[0]
    growth = resident_growth(stereo, min(arguments.voxel_sizes))
    results = [
        rounded(compare(stereo, depth, size, peers))
        for size, peers in zip(arguments.voxel_sizes, arguments.peer_poses, strict=True)
    ]
    print(
        json.dumps(
            {
                "benchmark": "integrate",
                "points": clouds[0].shape[0] * clouds[0].shape[1],
                "poses": arguments.poses,
                "max_range": MAX_RANGE,
                "cores": os.cpu_count(),
                "load_before": round(load, 2),
                **growth,
                "results": results,
            }
        )
    )


if __name__ == "__main__":
    main()
