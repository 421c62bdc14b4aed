"""Ways of the base, beside OMPL all in C++ over the same lattice in the same run; one JSON line.

All times are processor times of one thread.

Cluttered ground of 10 x 10 m with posts and walls, the rover of this repository, one lattice of
5 cm and 32 headings, asked in full beforehand. RRT-Connect answers the same queries three times:
here (OMPL in Python, one compiled call per motion), in C++ (`base_path_peer.cpp`, built with g++
against Debian's libompl-dev), and, the first few of them, in Python with a call per state. The
truth which queries have a solution is a complete search over the graph of 16 headings, written
here in plain numpy from stances alone.

    python benchmarks/bench_base_path.py [--queries 40] [--repetitions 5] [--seed 4]
"""

from __future__ import annotations

import argparse
import json
import math
import shutil
import statistics
import struct
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numba import njit

from infomap_ros.mapping.terrain.measures import largest_steps, plane_misfits
from infomap_ros.mapping.terrain.terrain import Terrain
from infomap_ros.motion import BasePlanner, BasePlannerConfig, RobotModel, Vehicle
from infomap_ros.motion.base import drive_sampling
from infomap_ros.motion.base.drive_graph import HEADINGS, MOVES
from infomap_ros.motion.base.drive_kernels import CLEAR, ask_cell, legs_of
from infomap_ros.motion.base.drive_space import DriveSpace

HERE = Path(__file__).resolve().parent
ROVER = HERE.parent / "config" / "rover.urdf"
DRIVING = {"arm_shoulder_joint": -1.2, "arm_elbow_joint": 2.4}
HALF, CELL, LIMIT = 5.0, 0.05, 2.0
SAMPLES = 10**7
PYTHON_QUERIES = 6


def cluttered_ground(seed: int) -> Terrain:
    """Gentle waves with posts, and walls with gaps of 0.6 m for a robot of 0.38 m."""
    rng = np.random.default_rng(seed)
    count = round(2.0 * HALF / CELL)
    x, y = (np.indices((count, count)) + 0.5) * CELL - HALF
    heights = 0.02 * np.sin(1.3 * x) * np.cos(0.9 * y)
    for a, b, radius in rng.uniform((-HALF, -HALF, 0.05), (HALF, HALF, 0.25), (60, 3)):
        heights[np.hypot(x - a, y - b) < radius] += 0.6
    for level in np.linspace(-4.0, 4.0, 4):
        gap = rng.uniform(-4.0, 4.0)
        heights[(np.abs(y - level) < 0.1) & (np.abs(x - gap) > 0.3)] += 1.0
        heights[(np.abs(y - level) < 0.5) & (np.abs(x - gap) < 0.3)] = 0.0
    steps, roughness = np.empty_like(heights), np.empty_like(heights)
    largest_steps(heights, steps)
    plane_misfits(heights, 2, 0.1, roughness)
    everywhere = np.full(heights.shape, np.float32(np.inf))
    return Terrain(
        *(grid.astype(np.float32) for grid in (heights, 0.0 * heights, roughness, steps, heights)),
        everywhere, everywhere, (-HALF, -HALF), CELL, (0.0, 0.0, 0.1),
    )  # fmt: skip


@njit
def ask_all(lattice: Any, grid: Any, ground: Any) -> None:
    for i in range(lattice.shape[0]):
        for j in range(lattice.shape[1]):
            for k in range(lattice.shape[2]):
                ask_cell(lattice, grid, i, j, k, ground)


class Truth:
    """The graph of 16 headings, every stance asked at once, searched breadth first."""

    def __init__(self, terrain: Terrain, vehicle: Vehicle) -> None:
        self.shape = (*terrain.heights.shape, 16)
        self.middles = terrain.centres_of
        nodes = np.argwhere(np.ones(self.shape, bool))
        cells, yaw, steps = nodes[:, :2], HEADINGS[nodes[:, 2]], MOVES[nodes[:, 2]].astype(float)
        turns = (HEADINGS[(nodes[:, 2] + 1) % 16] - yaw) % (2.0 * math.pi)
        still, straight = np.zeros(steps.shape), np.zeros(turns.shape)

        def good(move: np.ndarray, turn: np.ndarray, parts: np.ndarray, n: int) -> np.ndarray:
            """Stances after n of so many parts of a move or turn; good beyond the last."""
            share = np.minimum(n / parts, 1.0)
            xy = terrain.centres_of(cells + move * share[:, None])
            ok = vehicle.stances(terrain, np.column_stack([xy, yaw + turn * share])).ok
            return (ok | (n >= parts)).reshape(self.shape)

        lengths = np.ceil(np.hypot(*steps.T) - 1e-9)
        angles = np.ceil(turns / (2.0 * math.pi / 32.0) - 1e-9)
        self.nodes = good(still, straight, lengths + 1.0, 0)
        self.turns = good(still, turns, angles, 1) & good(still, turns, angles, 2)
        self.moves = good(steps, straight, lengths, 1) & good(steps, straight, lengths, 2)

    def reached_from(self, start: np.ndarray) -> np.ndarray:
        """Nodes that can be reached, shape (nx, ny, 16), by growing from the start."""
        reached = np.zeros(self.shape, bool)
        reached[tuple(start)] = True
        while True:
            grown = reached | (np.roll(reached & self.turns, 1, axis=2))
            grown |= np.roll(reached, -1, axis=2) & self.turns
            for h, (a, b) in enumerate(MOVES):
                grown[:, :, h] |= shifted(reached[:, :, h] & self.moves[:, :, h], a, b)
                grown[:, :, h] |= shifted(reached[:, :, h], -a, -b) & self.moves[:, :, h]
            grown &= self.nodes
            if (grown == reached).all():
                return reached
            reached = grown


def shifted(grid: np.ndarray, a: int, b: int) -> np.ndarray:
    """The grid moved by (a, b) cells, False where nothing came from."""
    moved = np.roll(grid, (a, b), axis=(0, 1))
    moved[: max(a, 0)], moved[:, : max(b, 0)] = False, False
    moved[moved.shape[0] + min(a, 0) :], moved[:, moved.shape[1] + min(b, 0) :] = False, False
    return moved


def make_queries(truth: Truth, count: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Starts and goals in the middles of nodes, (Q, 6), and which have a solution."""
    rng = np.random.default_rng(seed)
    nodes = np.argwhere(truth.nodes)
    queries, solvable = [], []
    while len(queries) < count:
        start = nodes[rng.integers(len(nodes))]
        reached = truth.reached_from(start)
        for goal in nodes[rng.integers(len(nodes), size=6)]:
            ends = [(*truth.middles(node[:2]), HEADINGS[node[2]]) for node in (start, goal)]
            if math.dist(ends[0][:2], ends[1][:2]) > 2.0:
                queries.append(np.concatenate(ends))
                solvable.append(reached[tuple(goal)])
    return np.array(queries[:count]), np.array(solvable[:count])


def run_peer(space: DriveSpace, queries: np.ndarray, repetitions: int, reach: float) -> np.ndarray:
    """Processor time [s], solved, length of each query by C++, shape (repetitions, Q, 3)."""
    if shutil.which("g++") is None or not Path("/usr/include/ompl-1.5").is_dir():
        sys.exit("bench_base_path needs its peer: apt-get install g++ libompl-dev libeigen3-dev")
    with tempfile.TemporaryDirectory() as folder:
        program, problem = Path(folder) / "peer", Path(folder) / "problem"
        includes = ["-I/usr/include/ompl-1.5", "-I/usr/include/eigen3"]
        source = ["-O3", "-march=native", "-std=c++17", str(HERE / "base_path_peer.cpp")]
        subprocess.run(["g++", *source, *includes, "-o", str(program), "-lompl"], check=True)
        numbers = struct.pack("<3i5d", *space.lattice.shape, *space.grid[:3], reach, LIMIT)
        lattice = (space.lattice == CLEAR).astype(np.uint8).tobytes()
        problem.write_bytes(numbers + lattice + struct.pack("<i", len(queries)) + queries.tobytes())
        out = subprocess.run(
            [str(program), str(problem), str(repetitions)],
            capture_output=True,
            check=True,
            text=True,
        )
    rows = [[float(number) for number in line.split()] for line in out.stdout.splitlines()]
    return np.array(rows).reshape(repetitions, len(queries), 3)


def timed(task: Callable[[], Any]) -> tuple[float, Any]:
    """Processor time [s] and result of a task on one thread; other processes disturb it less."""
    begin = time.process_time()
    result = task()
    return time.process_time() - begin, result


def sampled(space: DriveSpace, query: np.ndarray) -> tuple[float, bool, float]:
    """Processor time [s], solved, and length of one query with the package's sampling."""
    arguments = (space.lattice, space.grid, query[:3], query[None, 3:], True, 1.0)
    seconds, way = timed(
        lambda: drive_sampling.sample_way(*arguments, iter(range(SAMPLES)), space.ground)
    )
    length = 0.0 if way is None else float(np.hypot(*np.diff(way[:, :2], axis=0).T).sum())
    return seconds, way is not None, length


class PythonValidator(drive_sampling.DriveValidator):
    """A Python call for every state of a motion."""

    def checkMotion(self, first: Any, last: Any) -> bool:
        """Whether the way from one state to another is good; states are in cells."""
        a, b = ((s.getX(), s.getY(), s.getYaw()) for s in (first, last))
        turn, length, after = legs_of.py_func(*a, *b, True)
        angle, heading = 2.0 * math.pi / self._lattice.shape[2], a[2] + turn
        places = [(a[0], a[1], a[2] + t * turn) for t in shares(abs(turn) / angle)]
        for t in shares(length):
            places.append((a[0] + t * (b[0] - a[0]), a[1] + t * (b[1] - a[1]), heading))
        places += [(b[0], b[1], heading + t * after) for t in shares(abs(after) / angle)]
        return all(self._is_clear(*place) for place in places)

    def _is_clear(self, x: float, y: float, yaw: float) -> bool:
        nx, ny, headings = self._lattice.shape
        if not (0.0 <= x < nx and 0.0 <= y < ny):
            return False
        k = math.floor(yaw * headings / (2.0 * math.pi) + 0.5) % headings
        return bool(self._lattice[int(x), int(y), k] == CLEAR)


def shares(steps: float) -> list[float]:
    count = math.ceil(steps - 1e-9)
    return [n / count for n in range(1, count + 1)] or [0.0]


def in_python(space: DriveSpace, queries: np.ndarray) -> list[float]:
    """Milliseconds of some queries with a Python call per state."""
    compiled = drive_sampling.DriveValidator
    drive_sampling.DriveValidator = PythonValidator  # type: ignore[misc]
    try:
        return [1e3 * sampled(space, query)[0] for query in queries]
    finally:
        drive_sampling.DriveValidator = compiled  # type: ignore[misc]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--queries", type=int, default=40)
    parser.add_argument("--repetitions", type=int, default=5)
    parser.add_argument("--seed", type=int, default=4)
    options = parser.parse_args()
    terrain = cluttered_ground(options.seed)
    robot = RobotModel.from_urdf(ROVER, camera_frame="left_camera_optical_frame")
    vehicle = Vehicle.from_robot(robot, None, DRIVING)
    truth = Truth(terrain, vehicle)
    queries, solvable = make_queries(truth, options.queries, options.seed)
    config = BasePlannerConfig()
    space = DriveSpace(terrain, vehicle, config)
    ask_all(space.lattice[:1, :1], space.grid, space.ground)
    lattice_seconds, _ = timed(lambda: ask_all(space.lattice, space.grid, space.ground))
    solved = queries[solvable]
    peer = run_peer(space, solved, options.repetitions, config.reach)
    sampled(space, solved[0])
    ours = np.array(
        [[sampled(space, query) for query in solved] for _ in range(options.repetitions)]
    )
    python = in_python(space, solved[:PYTHON_QUERIES])
    plans = plan_all(terrain, vehicle, queries)
    flood_seconds, _ = timed(lambda: BasePlanner(terrain, vehicle).reachable_area(queries[0, :3]))
    print(json.dumps({
        **report(queries, solvable, ours, peer, python, plans),
        "stance_us_in_lattice": 1e6 * lattice_seconds / space.lattice.size,
        "reachable_area_ms": 1e3 * flood_seconds,
    }))  # fmt: skip


def report(
    queries: np.ndarray, solvable: np.ndarray, ours: np.ndarray, peer: np.ndarray,
    python: list[float], plans: list[Plan],
) -> dict[str, Any]:  # fmt: skip
    """What was found."""
    ours_ms, peer_ms = 1e3 * ours[..., 0], 1e3 * peer[..., 0]
    can, cannot = (
        [p for p, s in zip(plans, solvable, strict=True) if s == w] for w in (True, False)
    )
    return {
        "benchmark": "base_path",
        "queries": len(queries),
        "with_a_solution": len(can),
        "solved_of_these": sum(plan.complete for plan in can),
        "solved_of_the_others": sum(plan.complete for plan in cannot),
        "solved_by_search_instead": sum(plan.method == "search" for plan in can if plan.complete),
        "rrt_connect_ms_median": float(np.median(ours_ms)),
        "rrt_connect_ms_mean": float(ours_ms.mean()),
        "rrt_connect_solved": float(ours[..., 1].mean()),
        "cpp_ms_median": float(np.median(peer_ms)),
        "cpp_ms_mean": float(peer_ms.mean()),
        "cpp_solved": float(peer[..., 1].mean()),
        "ratio_of_medians": float(np.median(ours_ms) / np.median(peer_ms)),
        "ratio_of_means": float(ours_ms.mean() / peer_ms.mean()),
        "python_per_state_ms_mean": float(np.mean(python)),
        "same_queries_ms_mean": float(ours_ms[:, :PYTHON_QUERIES].mean()),
        "same_queries_cpp_ms_mean": float(peer_ms[:, :PYTHON_QUERIES].mean()),
        "plan_ms_median": statistics.median(plan.milliseconds for plan in can),
        "approach_ms_median": statistics.median(plan.milliseconds for plan in cannot),
        "way_m_mean": float(ours[..., 2][ours[..., 1] > 0].mean()),
        "cpp_way_m_mean": float(peer[..., 2][peer[..., 1] > 0].mean()),
        "plan_way_m_mean": statistics.mean(plan.length for plan in can),
    }


class Plan(NamedTuple):
    """What `BasePlanner.plan` made of a query."""

    milliseconds: float
    complete: bool
    method: str
    length: float


def plan_all(terrain: Terrain, vehicle: Vehicle, queries: np.ndarray) -> list[Plan]:
    """Plan each query with a planner that knows nothing before."""
    plans = []
    for query in queries:
        planner = BasePlanner(terrain, vehicle)
        seconds, path = timed(lambda p=planner, q=query: p.plan(q[:3], q[3:]))
        plans.append(Plan(1e3 * seconds, path.complete, path.method, path.length))
    return plans


if __name__ == "__main__":
    main()
