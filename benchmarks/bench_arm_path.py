"""Paths of the rover's arm around a shelf and through a window, with whole motions checked at once.

OMPL's RRTConnect plans with one compiled check per motion (`plan_arm_path`), beside one per state
at the same spacing (`ompl_state`), with the same robot and obstacles. Prints one JSON line:
milliseconds, and how many of the queries were solved.

    python benchmarks/bench_arm_path.py [--queries 60] [--time-limit 5]
"""

from __future__ import annotations

import argparse
import json
import statistics
import time
from collections.abc import Callable
from typing import Any

import numpy as np
from ompl import base as ob
from ompl import geometric as og
from ompl import util

from infomap_ros.geometry.resources import find_share
from infomap_ros.mapping.distance_field import DistanceField, field_of_blocked
from infomap_ros.motion.arm.arm_path import ArmPathConfig, plan_arm_path
from infomap_ros.motion.collision.body import CollisionBody
from infomap_ros.motion.collision.checker import CollisionChecker
from infomap_ros.motion.collision.kernels import is_free
from infomap_ros.motion.robot.robot_model import RobotModel

SIZE = 0.05
FIRST = np.array((-40, -40, -10))
SHAPE = (80, 80, 50)
BASE = np.eye(4)


def obstacles(name: str) -> DistanceField:
    """Two boards in front of the robot, or a wall with a window to its left."""
    x, y, z = ((np.indices(SHAPE).T + FIRST + 0.5) * SIZE).T
    if name == "shelf":
        boards = (abs(z - 0.25) < 0.03) | (abs(z - 0.75) < 0.03)
        blocked = (x > 0.45) & (x < 0.95) & (abs(y) < 0.5) & boards
    else:
        window = (abs(x - 0.1) < 0.2) & (abs(z - 0.45) < 0.2)
        blocked = (abs(y - 0.45) < 0.03) & ~window
    return field_of_blocked(blocked, FIRST, SIZE, outside_is_free=True)


def ompl_solver(
    checker: CollisionChecker, limit: float
) -> Callable[[np.ndarray, np.ndarray], bool]:
    """Solve one query; whether that was possible."""
    chain, scratch, space = checker.body.chain, checker.body.scratch(), checker.space(BASE)
    count = len(chain)
    weights = checker.body.arrays.reach.max(axis=0)
    spacing = 2.0 * checker.body.config.margin / float(weights.sum())

    def solve(start: np.ndarray, goal: np.ndarray) -> bool:
        states = ob.RealVectorStateSpace(count)
        bounds = ob.RealVectorBounds(count)
        for j in range(count):
            bounds.setLow(j, float(chain.lower[j]))
            bounds.setHigh(j, float(chain.upper[j]))
        states.setBounds(bounds)
        setup = og.SimpleSetup(states)
        information = setup.getSpaceInformation()
        setup.setStateValidityChecker(
            lambda s: bool(
                is_free(space, np.array([s[j] for j in range(count)]), space.T_map_base, scratch)
            )
        )
        information.setStateValidityCheckingResolution(spacing / states.getMaximumExtent())
        ends = []
        for q in (start, goal):
            state = states.allocState()
            for j in range(count):
                state[j] = float(q[j])
            ends.append(state)
        setup.setStartAndGoalStates(*ends)
        setup.setPlanner(og.RRTConnect(information))
        setup.solve(limit)
        if setup.haveExactSolutionPath():
            setup.simplifySolution(limit)
        return bool(setup.haveExactSolutionPath())

    return solve


def measure(solve: Callable[[np.ndarray, np.ndarray], bool], queries: Any) -> dict[str, float]:
    """Median and 95 % of the time of queries [ms], and the share that was solved."""
    seconds, solved = [], 0
    for start, goal in queries:
        begin = time.perf_counter()
        solved += solve(start, goal)
        seconds.append(time.perf_counter() - begin)
    return {
        "median_ms": round(1e3 * statistics.median(seconds), 3),
        "p95_ms": round(1e3 * float(np.quantile(seconds, 0.95)), 3),
        "solved": solved / len(queries),
    }


def main() -> None:
    """Run and print."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--queries", type=int, default=60)
    parser.add_argument("--time-limit", type=float, default=5.0, help="of OMPL [s]")
    arguments = parser.parse_args()
    util.setLogLevel(util.LOG_NONE)
    robot = RobotModel.from_urdf(find_share("config/rover.urdf"), "left_camera_optical_frame")
    body = CollisionBody.from_robot(robot)
    config = ArmPathConfig(samples=10**6)
    found: dict[str, Any] = {"queries": arguments.queries}
    for scene in ("shelf", "window"):
        checker = CollisionChecker(body, obstacles(scene))
        rng = np.random.default_rng(0)
        qs = rng.uniform(robot.arm.lower, robot.arm.upper, (40 * arguments.queries, len(robot.arm)))
        qs = qs[checker.are_free(qs, BASE)]
        pairs = zip(qs[::2], qs[1::2], strict=False)
        blocked = [pair for pair in pairs if checker.contact_between(*pair, BASE)]
        queries = blocked[: arguments.queries]
        solvers: dict[str, Callable[[np.ndarray, np.ndarray], bool]] = {
            "plan_arm_path": lambda a, b, c=checker: plan_arm_path(c, a, b, BASE, config).converged,
            "ompl_state": ompl_solver(checker, arguments.time_limit),
        }
        for name, solve in solvers.items():
            solve(*queries[0])
            found[f"{scene}_{name}"] = measure(solve, queries)
    print(json.dumps(found))


if __name__ == "__main__":
    main()
