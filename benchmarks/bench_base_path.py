"""Paths of the base by OMPL beside the lattice's, in the simulated worlds' terrains; one JSON line.

The ground of each world is taken from its true surface, in cells of 5 cm. Starts and goals are
drawn from what the rover of this repository can reach, at least 1.5 m apart, with any heading. The
same planner answers twice, with OMPL and without. Both paths are driven by the simulator's path
follower with an ideal vehicle, and both are held against bodies that are wider by 1 cm after
another: the clearance is the largest widening with which every stance on the path is still good.
Planning times are processor times of one thread, after the flood of the lattice.

    python benchmarks/bench_base_path.py [--seeds 2] [--queries 18] [--worlds mars office cave]
"""

from __future__ import annotations

import argparse
import json
import math
import time
from typing import Any, NamedTuple

import numpy as np

from infomap_ros.geometry.resources import find_share
from infomap_ros.mapping.terrain.measures import largest_steps, plane_misfits
from infomap_ros.mapping.terrain.terrain import Terrain
from infomap_ros.motion.base.base_planner import BasePlanner
from infomap_ros.motion.base.drive_space import BasePath
from infomap_ros.motion.base.path_following import PathFollower, PathFollowingConfig
from infomap_ros.motion.base.vehicle import Vehicle
from infomap_ros.motion.robot.robot_model import RobotModel
from infomap_ros.simulation.worlds.builder import World
from infomap_ros.simulation.worlds.scenes import WORLDS, make_world

DRIVING = {"arm_shoulder_joint": -1.2, "arm_elbow_joint": 2.4}
CELL, HEADROOM, DEPTH, CEILING = 0.05, 1.1, 0.5, 3.0  # [m]
LEAST_DISTANCE = 1.5  # [m]
PERIOD, LONGEST = 0.05, 600.0  # of the drive [s]
WIDENINGS = 0.01 * np.arange(16)  # [m]


class Figures(NamedTuple):
    """What is measured of a path."""

    length_m: float
    turning_rad: float
    turns: float
    cost_m: float
    drive_s: float
    clearance_m: float


def ground_of(world: World) -> Terrain:
    """The true ground of a world's region, as a map that knows all would have it."""
    low, high = world.region[:, :2]
    shape = tuple(int(n) for n in np.ceil((high - low) / CELL))
    cells = np.indices(shape).reshape(2, -1).T
    xy = low + (cells + 0.5) * CELL
    floor = world.terrain.height(xy)
    middle = np.column_stack([xy, floor + HEADROOM])
    down = world.surface.first_hits(middle, np.column_stack([xy, floor - DEPTH]))
    up = world.surface.first_hits(middle, middle + CEILING * np.eye(3)[2])
    heights = np.where(np.isfinite(down), middle[:, 2] - down * (HEADROOM + DEPTH), np.nan)
    overhead = middle[:, 2] + CEILING * up
    heights, overhead = heights.reshape(shape), overhead.reshape(shape)
    steps, roughness = np.empty_like(heights), np.empty_like(heights)
    largest_steps(heights, np.zeros(shape), steps)
    plane_misfits(heights, 2, 0.1, roughness)
    grids = (heights, np.zeros(shape), roughness, steps, heights, overhead, np.full(shape, np.inf))
    x, y, _ = world.start
    near = (x, y, float(world.terrain.height(np.array([x, y]))) + 0.1)
    return Terrain(
        *(grid.astype(np.float32) for grid in grids), (float(low[0]), float(low[1])), CELL, near
    )


def queries_of(planner: BasePlanner, start: np.ndarray, count: int, seed: int) -> np.ndarray:
    """Starts and goals on ground that can be reached, shape (count, 2, 3)."""
    rng = np.random.default_rng(seed)
    cells = np.argwhere(planner.reachable_area(start))
    found: list[np.ndarray] = []
    while len(found) < count:
        xy = planner.terrain.centers_of(cells[rng.integers(len(cells), size=2)])
        ends = np.column_stack([xy, rng.uniform(-math.pi, math.pi, 2)])
        if (
            math.dist(*xy) >= LEAST_DISTANCE
            and planner.vehicle.stances(planner.terrain, ends).ok.all()
        ):
            found.append(ends)
    return np.array(found)


def driving_time(path: BasePath) -> float:
    """Time that an ideal vehicle takes along a path [s]."""
    follower, pose = PathFollower(path.poses, PathFollowingConfig()), path.poses[0].copy()
    for step in range(round(LONGEST / PERIOD)):
        speed, rate = follower.velocity(pose)
        if follower.done:
            return step * PERIOD
        pose += PERIOD * np.array([speed * math.cos(pose[2]), speed * math.sin(pose[2]), rate])
    raise RuntimeError("the path follower does not arrive")


def clearance_of(path: BasePath, terrain: Terrain, vehicles: list[Vehicle]) -> float:
    """Largest widening of the body with which it stands well everywhere on the path [m]."""
    good = [bool(vehicle.stances(terrain, path.poses).ok.all()) for vehicle in vehicles]
    return float(WIDENINGS[good.index(False) - 1 if False in good else -1])


def figures_of(path: BasePath, planner: BasePlanner, vehicles: list[Vehicle]) -> Figures:
    """All measures of one path."""
    step = np.hypot(*np.diff(path.poses[:, :2], axis=0).T) > 1e-6
    turns = int((~step[1:] & step[:-1]).sum() + (~step[:1]).sum())
    cost = path.length + planner.config.turn_cost * path.turning
    clearance = clearance_of(path, planner.terrain, vehicles)
    return Figures(path.length, path.turning, turns, cost, driving_time(path), clearance)


def timed(planner: BasePlanner, ends: np.ndarray, samples: int | None) -> tuple[BasePath, float]:
    begin = time.process_time()
    path = planner.plan(ends[0], ends[1], samples)
    return path, time.process_time() - begin


def answers_on(
    ground: Terrain, start: np.ndarray, seed: int, count: int, vehicles: list[Vehicle]
) -> list[dict[str, Any]]:
    """Both paths of each query that has one."""
    planner = BasePlanner(ground, vehicles[0])
    rows = []
    for ends in queries_of(planner, start, count, seed):
        planner.plan(ends[0], ends[1], 0)
        lattice, lattice_s = timed(planner, ends, 0)
        if not lattice.complete:
            continue
        path, seconds = timed(planner, ends, None)
        rows.append({
            "method": path.method,
            "seconds": seconds - lattice_s,
            "same": np.array_equal(planner.plan(ends[0], ends[1]).poses, path.poses),
            "lattice": figures_of(lattice, planner, vehicles),
            "driven": figures_of(path, planner, vehicles),
        })  # fmt: skip
    return rows


def summary(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """Means over queries, and the medians of the driving time."""
    driven = np.array([row["driven"] for row in rows])
    lattice = np.array([row["lattice"] for row in rows])
    seconds = np.array([row["seconds"] for row in rows])
    return {
        "queries": len(rows),
        "by_ompl": float(np.mean([row["method"] == "ompl" for row in rows])),
        "repeated_exactly": float(np.mean([row["same"] for row in rows])),
        "plan_ms_mean": 1e3 * float(seconds.mean()),
        "plan_ms_p95": 1e3 * float(np.quantile(seconds, 0.95)),
        "plan_ms_max": 1e3 * float(seconds.max()),
        "lattice": dict(zip(Figures._fields, lattice.mean(axis=0).tolist(), strict=True)),
        "driven": dict(zip(Figures._fields, driven.mean(axis=0).tolist(), strict=True)),
        "lattice_median_s": float(np.median(lattice[:, 4])),
        "driven_median_s": float(np.median(driven[:, 4])),
        "faster": float((driven[:, 4] < lattice[:, 4] - PERIOD).mean()),
        "slower": float((driven[:, 4] > lattice[:, 4] + PERIOD).mean()),
        "less_clearance": float((driven[:, 5] < lattice[:, 5] - 1e-9).mean()),
        "more_clearance": float((driven[:, 5] > lattice[:, 5] + 1e-9).mean()),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=2)
    parser.add_argument("--queries", type=int, default=18)
    parser.add_argument("--worlds", nargs="+", choices=WORLDS, default=WORLDS)
    options = parser.parse_args()
    text = find_share("config/rover.urdf").read_text(encoding="utf-8")
    robot = RobotModel.from_urdf(text, camera_frame="left_camera_optical_frame")
    vehicles = [Vehicle.from_robot(robot, None, DRIVING, float(by)) for by in WIDENINGS]
    rows: dict[str, list[dict[str, Any]]] = {name: [] for name in options.worlds}
    for name in rows:
        for seed in range(1, options.seeds + 1):
            world = make_world(name, seed)
            start = np.array(world.start)
            rows[name] += answers_on(ground_of(world), start, seed, options.queries, vehicles)
    print_summary(rows)


def print_summary(rows: dict[str, list[dict[str, Any]]]) -> None:
    """One JSON line."""
    worlds = {name: summary(found) for name, found in rows.items()}
    total = summary([row for found in rows.values() for row in found])
    print(json.dumps({"benchmark": "base_path", **total, "worlds": worlds}))


if __name__ == "__main__":
    main()
