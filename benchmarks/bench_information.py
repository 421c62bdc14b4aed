"""What views are expected to tell, beside OctoMap on the same rays and map; one JSON line.

The room in `room.py` after 20 scans, range 5 m, views of 80 x 60 rays. OctoMap gets the map as a
file and the rays as numbers, and sums in C++ the entropies along each ray times the probability to
see them (`octomap_rays.cpp`); it is built with g++ against the OctoMap that coal brings along.
Times are of the processor, because others may be using it too; only the gain of a second thread is
a ratio of wall-clock times, the best of several.

    python benchmarks/bench_information.py [--views 24] [--voxel-sizes 0.05 0.02] [--repeats 5]
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import os
import shutil
import statistics
import subprocess
import sys
import sysconfig
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import room

from infomap_ros.geometry import PinholeCamera
from infomap_ros.mapping import VoxelMap, VoxelMapConfig
from infomap_ros.mapping.files.octomap_file import write_ot
from infomap_ros.views.information.gains import field_around
from infomap_ros.views.information.view_information import expected_information
from infomap_ros.views.information.view_query import InformationConfig, camera_rays

HERE = Path(__file__).resolve().parent
RANGE = 5.0
CAMERA = PinholeCamera(80, 60, room.CAMERA.fx / 8.0, room.CAMERA.fy / 8.0, 39.5, 29.5)
CONFIG = InformationConfig(ray_spacing=1.0001 / CAMERA.fx)
RAYS = CAMERA.width * CAMERA.height
POSITIONS, ORIENTATIONS = 40, 24
QUICK_SPACING = 0.05  # [rad], as of `ExpectedInformation`
POSE_COVARIANCE = np.diag([1e-4, 1e-4, 1e-4, 1e-5, 1e-5, 1e-5])


def built_peer(folder: Path) -> Path:
    """Compile the OctoMap side."""
    prefix, program = Path(sysconfig.get_path("purelib")) / "cmeel.prefix", folder / "octomap_rays"
    if not (prefix / "include/octomap/octomap.h").exists() or shutil.which("g++") is None:
        sys.exit("bench_information needs g++ and the OctoMap of the Python package coal")
    libraries = [f"-L{prefix}/lib", "-loctomap", "-loctomath", f"-Wl,-rpath,{prefix}/lib"]
    source = ["-O3", "-march=native", str(HERE / "octomap_rays.cpp"), f"-I{prefix}/include"]
    subprocess.run(["g++", *source, "-o", str(program), *libraries], check=True)
    return program


def room_map(size: float) -> VoxelMap:
    """The room after 20 scans."""
    voxel_map = VoxelMap(VoxelMapConfig(voxel_size=size, max_range=RANGE))
    for pose in room.poses(20):
        cloud = room.cloud(pose)
        voxel_map.integrate(cloud, pose, room.covariances(cloud), POSE_COVARIANCE, room.CAMERA)
    return voxel_map


def octomap_seconds(
    program: Path, voxel_map: VoxelMap, poses: np.ndarray, folder: Path, repeats: int
) -> list[float]:
    """Processor time of OctoMap per ray [s], one entry per repeat."""
    write_ot(voxel_map, folder / "map.ot")
    directions = np.einsum(
        "mij,nj->mni", poses[:, :3, :3], camera_rays(CAMERA, CONFIG.ray_spacing)[0]
    )
    origins = np.broadcast_to(poses[:, None, :3, 3], directions.shape)
    np.concatenate([origins, directions], -1).astype(np.float32).tofile(folder / "rays.bin")
    count = directions.shape[0] * directions.shape[1]
    files = [str(folder / "map.ot"), str(folder / "rays.bin")]
    numbers = [str(count), str(RANGE), str(CONFIG.min_visibility), str(repeats)]
    result = subprocess.run(
        [str(program), *files, *numbers], check=True, capture_output=True, text=True
    )
    return [float(line) / count for line in result.stdout.split()[:repeats]]


def seconds(task: Callable[[], Any], clock: Callable[[], float], repeats: int) -> list[float]:
    """Times of a task [s]."""
    task()
    times = []
    for _ in range(repeats):
        start = clock()
        task()
        times.append(clock() - start)
    return times


def candidates(seed: int = 3) -> tuple[np.ndarray, np.ndarray]:
    """Positions in the room (P, 3) and orientations (O, 3, 3), level and looking down."""
    rng = np.random.default_rng(seed)
    positions = np.c_[rng.uniform(-3.0, 3.0, (POSITIONS, 2)), rng.uniform(0.5, 1.5, POSITIONS)]
    rotations = []
    for n in range(ORIENTATIONS):
        yaw, pitch = 2.0 * np.pi * (n // 2) / (ORIENTATIONS // 2), (0.1, 0.5)[n % 2]
        cos, sin = np.cos([yaw, pitch]), np.sin([yaw, pitch])
        forward = np.array([cos[0] * cos[1], sin[0] * cos[1], -sin[1]])
        right = np.cross(forward, [0.0, 0.0, 1.0]) / cos[1]
        rotations.append(np.stack([right, np.cross(forward, right), forward], axis=1))
    return positions, np.array(rotations)


def ranking(voxel_map: VoxelMap, octomap: float, repeats: int) -> dict[str, float]:
    """Views by few rays each, as all candidates are ranked at first, against all their rays."""
    positions, rotations = candidates()
    poses = np.tile(np.eye(4), (*(len(positions), len(rotations)), 1, 1))
    poses[..., :3, :3], poses[..., :3, 3] = rotations, positions[:, None]
    poses, count = poses.reshape(-1, 4, 4), len(positions) * len(rotations)

    def rate(config: InformationConfig) -> np.ndarray:
        return expected_information(voxel_map, poses, CAMERA, RANGE, config=config)

    few = dataclasses.replace(CONFIG, ray_spacing=QUICK_SPACING)
    time_each = min(seconds(lambda: rate(few), time.process_time, repeats)) / count
    every, coarse = rate(CONFIG), rate(few)
    return {
        "candidates": count,
        "us_per_candidate": 1e6 * time_each,
        "ratio_per_candidate": octomap * RAYS / time_each,
        "rms_error_of_largest": float(np.sqrt(np.mean((coarse - every) ** 2)) / every.max()),
        "loss_of_choice": float(1.0 - every[coarse.argmax()] / every.max()),
    }


def compare(program: Path, size: float, views: int, repeats: int) -> dict[str, Any]:
    """All figures at one voxel size."""
    voxel_map, poses = room_map(size), np.array(room.poses(views, 7))
    rays = views * RAYS

    def rate(threads: int = 1) -> None:
        expected_information(voxel_map, poses, CAMERA, RANGE, config=CONFIG, threads=threads)

    with tempfile.TemporaryDirectory() as folder:
        octomap = octomap_seconds(program, voxel_map, poses[:4], Path(folder), repeats)
    one = [t / rays for t in seconds(rate, time.process_time, repeats)]
    prepare = seconds(
        lambda: field_around(voxel_map, poses[:, :3, 3], RANGE, CONFIG), time.process_time, repeats
    )
    both = [min(seconds(lambda n=n: rate(n), time.perf_counter, 3 * repeats)) for n in (1, 2)]
    return {
        "voxel_size": size,
        "octomap_million_rays_per_s": 1e-6 / min(octomap),
        "million_rays_per_s": 1e-6 / min(one),
        "ratio_per_ray": statistics.median(octomap) / statistics.median(one),
        "ratio_2_threads": both[0] / both[1],
        "prepare_ms": 1e3 * min(prepare),
        **ranking(voxel_map, statistics.median(octomap), repeats),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--views", type=int, default=24)
    parser.add_argument("--voxel-sizes", type=float, nargs="+", default=[0.05, 0.02])
    parser.add_argument("--repeats", type=int, default=5)
    arguments = parser.parse_args()
    load = os.getloadavg()[0]
    with tempfile.TemporaryDirectory() as folder:
        program = built_peer(Path(folder))
        results = [
            compare(program, size, arguments.views, arguments.repeats)
            for size in arguments.voxel_sizes
        ]
    figures = [
        {k: round(v, 4) if isinstance(v, float) else v for k, v in result.items()}
        for result in results
    ]
    print(
        json.dumps(
            {
                "benchmark": "information",
                "rays_per_view": RAYS,
                "views": arguments.views,
                "max_range": RANGE,
                "cores": os.cpu_count(),
                "load_before": round(load, 2),
                "results": figures,
            }
        )
    )


if __name__ == "__main__":
    main()
