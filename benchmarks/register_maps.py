"""Do two maps without a common frame find each other, and with what error?

Of each simulated world two maps are made from scans with errors of range and pose, from places of
which a share is common to both, in frames that are turned and shifted by chance; of a real kitchen
(`--data`) the first and the second half of the frames. `infomap_ros.team.registration` is asked for
the place of the one in the other, which must not be wrong. docs/results/registration.md says what
the figures mean. One JSON file per pair in the output folder, not made again where it is there.

    python benchmarks/register_maps.py --out out/registration
    python benchmarks/register_maps.py --worlds cave:2 --common 0.2 --data DATA --out DIR
"""

from __future__ import annotations

import argparse
import itertools
import json
import time
from pathlib import Path
from typing import Any

import numpy as np
from kpi import ROOM, placed_clouds
from localize_sequences import SEQUENCES, bag_of
from rows import markdown_table, software
from scipy.spatial.transform import Rotation

from infomap_ros.errors import InvalidInputError
from infomap_ros.geometry import (
    PinholeCamera,
    PoseUncertainty,
    invert_transform,
    make_transform,
)
from infomap_ros.geometry.atomic_file import write_json, write_text
from infomap_ros.mapping import VoxelMap, VoxelMapConfig
from infomap_ros.simulation.exploring.visible_surface import reachable_cameras
from infomap_ros.simulation.worlds.builder import World
from infomap_ros.simulation.worlds.gallery import look_at
from infomap_ros.simulation.worlds.scenes import SCENES, scene_of
from infomap_ros.studies.noisy_scans import RangeNoise, misplaced, random_pose_covariance
from infomap_ros.team.registration import register_maps

WORLDS = ("office:1", "cave:2", "mars:1")
COMMON = (0.0, 0.2, 0.8)
CAMERA = PinholeCamera(width=160, height=120, fx=110.0, fy=110.0, cx=79.5, cy=59.5)
NOISE = RangeNoise(along=0.006, across=0.001)
SCANS, REACH, SIZE = 40, 4.0, 9.0  # of each map, [m], [m] of the world
WRONG = 0.2, 5.0  # off at the middle of the second map [m], or turned [degrees]
Pair = tuple[VoxelMap, VoxelMap, np.ndarray]
COLUMNS = ("maps", "surface in common", "result", "off", "turned", "sigma", "NEES / 6", "time")


def simulated(name: str, common: float) -> Pair:
    """Two maps of a world, and T_first_second."""
    kind, seed = name.split(":")
    rng = np.random.default_rng(100 * int(seed) + round(100 * common))
    key, config = scene_of(kind, int(seed), size=SIZE)
    world = SCENES[key].build(config, "")
    places = reachable_cameras(world)
    along = np.argsort(np.argsort(places[:, 0])) / len(places)
    end = 0.5 * (1.0 + common) if common else 0.4  # without common places a fifth lies between
    turn = Rotation.from_euler("zyx", [rng.uniform(-np.pi, np.pi), *rng.normal(0.0, 0.02, 2)])
    T_first_second = make_transform(turn.as_matrix(), rng.uniform(-5.0, 5.0, 3))
    first = scanned(world, places[along < end], np.eye(4), rng)
    second = scanned(world, places[along > 1.0 - end], invert_transform(T_first_second), rng)
    return first, second, T_first_second


def scanned(
    world: World, places: np.ndarray, T_map_world: np.ndarray, rng: np.random.Generator
) -> VoxelMap:
    """Map of scans from some of the places."""
    voxel_map = VoxelMap(VoxelMapConfig(max_range=REACH))
    for place in places[rng.choice(len(places), SCANS, replace=len(places) < SCANS)]:
        pose = looking(place, rng)
        points, covariances = NOISE.measure(depth_of(world, pose), CAMERA, rng)
        covariance = random_pose_covariance(rng)
        error = rng.multivariate_normal(np.zeros(6), covariance)
        known = PoseUncertainty(np.zeros((6, 6)), white=covariance)
        estimate = misplaced(T_map_world @ pose, error)
        voxel_map.integrate(points, estimate, covariances, known, camera=CAMERA)
    return voxel_map


def looking(place: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Pose of a camera that looks anywhere, level or down by up to 0.5 rad."""
    yaw, tilt = rng.uniform(-np.pi, np.pi), rng.uniform(0.0, 0.5)
    ahead = np.array([np.cos(yaw) * np.cos(tilt), np.sin(yaw) * np.cos(tilt), -np.sin(tilt)])
    return look_at(place, place + ahead)


def depth_of(world: World, T_world_camera: np.ndarray) -> np.ndarray:
    """Exact depth, (height, width) [m], NaN where nothing is met."""
    rays = CAMERA.back_project(np.ones((CAMERA.height, CAMERA.width))).reshape(-1, 3)
    ends = T_world_camera[:3, 3] + REACH * rays.astype(float) @ T_world_camera[:3, :3].T
    depth = REACH * world.surface.first_hits(
        np.broadcast_to(T_world_camera[:3, 3], ends.shape), ends
    )
    depth[~((depth > 0.2) & np.isfinite(depth))] = np.nan
    return depth.reshape(CAMERA.height, CAMERA.width)


def kitchen(data: Path, work: Path) -> Pair:
    """Maps of the two halves of the frames of the kitchen, and T_first_second."""
    path = bag_of(SEQUENCES[ROOM], data, work)
    if path is None:
        raise InvalidInputError(str(data), f"has no {ROOM}")
    turn = Rotation.from_euler("zyx", [2.0, 0.3, -0.2]).as_matrix()
    T_first_second = make_transform(turn, (1.0, -3.0, 0.5))
    maps = [VoxelMap(VoxelMapConfig(voxel_size=0.03)) for _ in range(2)]
    for number, cloud, T_first_camera in placed_clouds(path):
        half = int(number >= 125)
        pose = invert_transform(T_first_second) @ T_first_camera if half else T_first_camera
        maps[half].integrate(
            cloud.organized_points, pose, cloud.organized_covariances, camera=cloud.camera
        )
    return maps[0], maps[1], T_first_second


def asked(name: str, pair: Pair) -> dict[str, Any]:
    """What is found, against the truth."""
    first, second, truth = pair
    row: dict[str, Any] = {"software": software(), "maps": name, "common": share(*pair)}
    begin = time.perf_counter()
    try:
        found = register_maps(first, second)
    except InvalidInputError as error:
        return {
            **row,
            "result": f"refused: {error.problem}",
            "seconds": time.perf_counter() - begin,
        }
    row["seconds"] = time.perf_counter() - begin
    T, middle = found.T_first_second, second.gaussians()[1].mean(axis=0)
    turn = Rotation.from_matrix(truth[:3, :3] @ T[:3, :3].T).as_rotvec()
    error = np.append(truth[:3, 3] - T[:3, 3], turn)
    lever = np.hstack([np.eye(3), -np.cross(np.eye(3), T[:3, :3] @ middle)])
    sigma = np.sqrt(np.trace(lever @ found.covariance @ lever.T))
    off = np.linalg.norm((truth - T)[:3] @ np.append(middle, 1.0))
    turned = np.degrees(np.linalg.norm(turn))
    return {
        **row,
        "result": "wrong" if off > WRONG[0] or turned > WRONG[1] else "found",
        "off": float(off),
        "turned": float(turned),
        "sigma": float(sigma),
        "nees": float(error @ np.linalg.solve(found.covariance, error) / 6.0),
    }


def share(first: VoxelMap, second: VoxelMap, truth: np.ndarray) -> float:
    """Surface voxels of the second map of which the first has surface within one, at the truth."""
    points = second.gaussians()[1] @ truth[:3, :3].T + truth[:3, 3]
    steps = first.config.voxel_size * np.array(list(itertools.product((-1, 0, 1), repeat=3)))
    near = [first.log_odds(points + step) > 0.0 for step in steps]
    return float(np.mean(np.any(near, axis=0)))


def cells(row: dict[str, Any]) -> tuple[str, ...]:
    """A row of the table."""
    head = row["maps"], f"{row['common']:.0%}", row["result"]
    tail = f"{row['seconds']:.0f} s"
    if "off" not in row:
        return (*head, "", "", "", "", tail)
    off, sigma = (f"{1e3 * row[key]:.1f} mm" for key in ("off", "sigma"))
    return (*head, off, f"{row['turned']:.2f} deg", sigma, f"{row['nees']:.2f}", tail)


def main() -> int:
    """Run the pairs that are not there, print the table; 1 where one was wrong."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, required=True, help="folder of the results")
    parser.add_argument("--worlds", nargs="*", default=WORLDS, help="as kind:seed")
    parser.add_argument("--common", nargs="*", type=float, default=COMMON, help="share of places")
    parser.add_argument("--data", type=Path, help="folder of the sequences, for the kitchen")
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    pairs = {
        f"{name}, {common:.0%} of the places": (simulated, name, common)
        for name in options.worlds
        for common in options.common
    }
    if options.data:
        pairs["kitchen, halves"] = (kitchen, options.data, options.out / "kitchen")
    rows = []
    for number, (name, (make, *given)) in enumerate(pairs.items()):
        file = options.out / f"{name.replace(':', '_').replace(' ', '_')}.json"
        if not file.is_file():
            write_json(file, asked(name, make(*given)))
        rows.append(json.loads(file.read_text("utf-8")))
        print(f"{number + 1} of {len(pairs)}", *cells(rows[-1]), flush=True)
    text = markdown_table(COLUMNS, map(cells, rows))
    write_text(options.out / "table.md", text)
    print(text)
    return int(any(row["result"] == "wrong" for row in rows))


if __name__ == "__main__":
    raise SystemExit(main())
