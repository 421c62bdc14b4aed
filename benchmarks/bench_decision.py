"""How long the choice of the next view takes, by size of the map and number of candidates.

Halls with boxes on a flat floor, known but for what lies behind the boxes and far corners; 5 cm
voxels. The rover of `config/rover.urdf` stands in the middle: inverse kinematics, places to stand
and paths of arm and base are asked for, as on a robot. Of `--repeats` decisions, with other
candidates each, the one with the least processor time counts, summed over both threads, because
others may be using the machine. Prints one JSON line; `--figure` draws.

    python benchmarks/bench_decision.py [--sides 6 10 15 20] [--candidates 250 500 1000 2000 4000]
        [--repeats 3] [--figure docs/figures/decision_time.png]
"""

from __future__ import annotations

import argparse
import json
import time
from pathlib import Path
from typing import Any

import numpy as np

from infomap_ros.geometry import Box, PinholeCamera, PlacedSolid, StereoRig, make_transform
from infomap_ros.geometry.atomic_file import save_figure
from infomap_ros.geometry.resources import find_share
from infomap_ros.mapping import VoxelMap, VoxelMapConfig
from infomap_ros.motion.reaching import WholeBodyReach
from infomap_ros.motion.robot.robot_model import RobotModel
from infomap_ros.motion.robot.solid_extent import camera_heights, solid_extent
from infomap_ros.studies.noisy_scans import AnalyticScene
from infomap_ros.views.decision import ViewDecision
from infomap_ros.views.information.view_information import ExpectedInformation
from infomap_ros.views.information.view_query import InformationConfig
from infomap_ros.views.next_best_view import NextBestView, NextBestViewConfig
from infomap_ros.views.sampling.candidates import CandidateConfig
from infomap_ros.views.sampling.orientations import look_rotations
from infomap_ros.views.situation import RegionOfTask, Situation

VOXEL, RANGE, HEIGHT = 0.05, 5.0, 3.0
CAMERA = PinholeCamera(160, 120, 130.0, 130.0, 79.5, 59.5)
RIG = StereoRig(CAMERA, CAMERA, 0.1)
JOINTS = {"arm_shoulder_joint": -0.35, "arm_elbow_joint": 0.65}
STRATEGIES = ("largest_information", "look_ahead")


def hall(side: float, seed: int = 1) -> AnalyticScene:
    """A hall of `side` x `side` x 3 m about the origin with a box per 7 square meters."""
    rng = np.random.default_rng(seed)
    half = 0.5 * side
    planes = [(1, 0, 0, -half), (-1, 0, 0, -half), (0, 1, 0, -half), (0, -1, 0, -half)]
    solids = []
    for place in rng.uniform(-half + 0.5, half - 0.5, (int(side * side / 7.0), 2)):
        x, y, z = rng.uniform(0.3, 1.0, 3)
        if np.linalg.norm(place) > 1.8:
            solids.append(PlacedSolid(Box((x, y, z)), make_transform(np.eye(3), (*place, z / 2))))
    return AnalyticScene(np.array([*planes, (0, 0, 1, 0), (0, 0, -1, -HEIGHT)], float), solids)


def seen(scene: AnalyticScene, side: float, seed: int = 2) -> VoxelMap:
    """The hall after scans from places 2.5 m apart, one in five left out."""
    rng = np.random.default_rng(seed)
    voxel_map = VoxelMap(VoxelMapConfig(voxel_size=VOXEL, max_range=RANGE))
    count = max(1, round(side / 2.5))
    line = (np.arange(count) - 0.5 * (count - 1)) * 2.5
    for place in np.stack(np.meshgrid(line, line), axis=-1).reshape(-1, 2):
        position = np.array((*(place + rng.uniform(-0.3, 0.3, 2)), 0.9))
        middle = np.linalg.norm(position[:2]) < 2.0
        if not middle and (rng.random() < 0.2 or scene.signed_distance(position[None])[0] < 0.2):
            continue
        near = [s for s in scene.solids if np.linalg.norm(s.transform[:3, 3] - position) < 8.0]
        look_around(voxel_map, AnalyticScene(scene.planes, near), position)
    return voxel_map


def look_around(voxel_map: VoxelMap, scene: AnalyticScene, position: np.ndarray) -> None:
    """Two scans in each of eight directions, a little down."""
    azimuths = np.arange(8) * np.pi / 4.0
    for rotation in look_rotations(azimuths, np.full(8, -0.35)):
        pose = make_transform(rotation, position)
        depth = scene.depth_image(pose, CAMERA)
        points = CAMERA.back_project(np.where(depth < 8.0, depth, np.nan))
        for _ in range(2):
            voxel_map.integrate(points, pose, camera=CAMERA)


def rover() -> RobotModel:
    text = find_share("config/rover.urdf").read_text(encoding="utf-8")
    return RobotModel.from_urdf(text, camera_frame="left_camera_optical_frame")


def joints_of(robot: RobotModel) -> dict[str, float]:
    zero = {joint.name: float(np.clip(0.0, joint.lower, joint.upper)) for joint in robot.joints}
    return {**zero, **JOINTS}


def decide(
    chooser: NextBestView, robot: RobotModel, voxel_map: VoxelMap, side: float, seed: int
) -> tuple[float, float, ViewDecision]:
    """One decision from what a robot knows: wall-clock and processor time [s], and the result."""
    half, joints = 0.5 * side, joints_of(robot)
    T_map_base = make_transform(np.eye(3), (0.0, 0.0, robot_height(robot)))
    T_map_camera = T_map_base @ robot.forward_kinematics(joints, robot.camera_frame)
    start, start_processor = time.perf_counter(), time.process_time()
    body = [
        PlacedSolid(solid.solid, T_map_base @ solid.transform)
        for solid in robot.solids_in(robot.base_frame, joints)
    ]
    reach = WholeBodyReach(robot, voxel_map, T_map_base, joints)
    situation = Situation(
        voxel_map,
        CAMERA,
        RANGE,
        T_map_camera,
        region=RegionOfTask((-half, -half, -0.2), (half, half, 2.0)),
        free_body=body,
        heights=camera_heights(robot),
        ground_height=reach.terrain.height_at,
    )
    decision = chooser.select(situation, reach, np.random.default_rng(seed))
    return time.perf_counter() - start, time.process_time() - start_processor, decision


def robot_height(robot: RobotModel) -> float:
    """Of the base frame above flat ground [m]."""
    solids = robot.solids_in(robot.base_frame, joints_of(robot))
    return -min(float(solid_extent(placed)[0][2]) for placed in solids)


def chooser_of(candidates: int, strategy: str) -> NextBestView:
    config = NextBestViewConfig(candidates=CandidateConfig(candidates=candidates))
    information = ExpectedInformation(config=InformationConfig.of_stereo(RIG), threads=2)
    return NextBestView(config, strategy, information)


def measure(
    voxel_map: VoxelMap,
    robot: RobotModel,
    side: float,
    candidates: int,
    strategy: str,
    repeats: int,
) -> dict[str, Any]:
    """The decision of several that took the least processor time."""
    chooser = chooser_of(candidates, strategy)
    runs = [decide(chooser, robot, voxel_map, side, seed) for seed in range(repeats)]
    seconds, processor, decision = min(runs, key=lambda run: run[1])
    stages = {name: round(spent, 4) for name, spent in decision.seconds.items()}
    stages["terrain"] = round(seconds - sum(decision.seconds.values()), 4)
    return {
        "side_m": side,
        "known_voxels": voxel_map.known_voxels,
        "candidates": candidates,
        "strategy": strategy,
        "seconds": round(seconds, 4),
        "processor_seconds": round(processor, 4),
        "chosen": decision.chosen is not None,
        "stages": stages,
    }


def draw(rows: list[dict[str, Any]], path: Path) -> None:
    """Processor time over the size of the map and over the number of candidates."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    figure, axes = pyplot.subplots(1, 2, figsize=(9.0, 3.6), sharey=True)
    middle = min({row["side_m"] for row in rows}, key=lambda side: abs(side - 10.0))
    for strategy in STRATEGIES:
        own = [row for row in rows if row["strategy"] == strategy]
        by_size = sorted(
            (r["known_voxels"] * 1e-6, r["processor_seconds"])
            for r in own
            if r["candidates"] == 1000
        )
        by_count = sorted(
            (r["candidates"], r["processor_seconds"]) for r in own if r["side_m"] == middle
        )
        axes[0].plot(*zip(*by_size, strict=True), "o-", label=strategy)
        axes[1].plot(*zip(*by_count, strict=True), "o-", label=strategy)
    axes[0].set(title="1,000 candidates", xlabel="known voxels [million]")
    axes[1].set(title=f"{middle:g} x {middle:g} x {HEIGHT:g} m", xlabel="candidates")
    axes[0].set_ylabel("processor time of a decision [s]")
    axes[0].set_ylim(bottom=0.0)
    axes[1].legend()
    figure.tight_layout()
    save_figure(figure, path, 130)


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--sides", type=float, nargs="+", default=[6.0, 10.0, 15.0, 20.0])
    parser.add_argument("--candidates", type=int, nargs="+", default=[250, 500, 1000, 2000, 4000])
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--figure", type=Path)
    options = parser.parse_args()
    robot, rows = rover(), []
    middle = min(options.sides, key=lambda side: abs(side - 10.0))
    for side in options.sides:
        voxel_map = seen(hall(side), side)
        decide(chooser_of(50, STRATEGIES[1]), robot, voxel_map, side, 0)  # compiles what is not
        for count in options.candidates if side == middle else [1000]:
            for strategy in STRATEGIES:
                row = measure(voxel_map, robot, side, count, strategy, options.repeats)
                rows.append(row)
    print(json.dumps({"benchmark": "decision", "voxel_size": VOXEL, "rows": rows}))
    if options.figure:
        draw(rows, options.figure)


if __name__ == "__main__":
    main()
