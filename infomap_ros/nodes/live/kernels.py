"""Compile what the nodes need once, before several processes need it at the same time.

Each process would compile by itself what is not in the cache yet; twelve of them get into each
other's way. Where all is in the cache, this takes some seconds.
"""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable, Mapping

import numpy as np

from infomap_ros.errors import ProcessError
from infomap_ros.exploration.view_planner_config import ViewPlannerConfig
from infomap_ros.geometry import PinholeCamera
from infomap_ros.mapping import VoxelMap, VoxelMapConfig
from infomap_ros.nodes.fusion import map_warm_up
from infomap_ros.nodes.locating import localization_warm_up
from infomap_ros.nodes.planning import plan_warm_up
from infomap_ros.pipeline.range_estimator import StereoRangeEstimator
from infomap_ros.stereo import StereoConfig
from infomap_ros.team import TeamConfig, TeamMember


def _share() -> None:
    """Two robots tell each other the same small map, and lose every third update."""
    config, sharing = VoxelMapConfig(voxel_size=0.05), TeamConfig(recovery=0.0)
    camera = PinholeCamera(32, 24, 30.0, 30.0, 15.5, 11.5)
    points = camera.back_project(np.full((24, 32), 1.0))
    covariances = np.broadcast_to(np.float32(1e-4) * np.eye(3, dtype=np.float32), (24, 32, 3, 3))
    own_map, count = VoxelMap(config), 0
    own_map.track_changes(True)
    robots = [TeamMember(number, number + 1, 1000, config, sharing) for number in range(2)]
    for now in np.arange(0.0, 8.0, 0.5):
        if now < 2.0:
            own_map.integrate(points, np.eye(4), covariances, 1e-6 * np.eye(6), camera)
        for me, other in (robots, robots[::-1]):
            for rows in me.tell(own_map, now):
                count += 1
                if count % 3:
                    other.hear_update(rows, now)
            for rows in me.digests(now):
                other.hear_digest(rows, now)
            for rows in me.requests(now):
                other.hear_request(rows, now)
    for robot in robots:
        robot.replica.hash()


STEPS: Mapping[str, Callable[[], object]] = {
    "range": lambda: StereoRangeEstimator(StereoConfig(), rectify=True).warm_up(),
    "map": lambda: map_warm_up.warm_up(1),
    "sharing": _share,
    "localisation": localization_warm_up.warm_up,
    "planning": lambda: plan_warm_up.warm_up(ViewPlannerConfig(threads=1)),
}
"""What is compiled, in its order, by name."""


def compile_kernels(tell: Callable[[str], None]) -> None:
    """Run this module as a process of its own, whose memory is gone afterwards.

    Args:
        tell: told each step before it begins.

    Raises:
        ProcessError: it failed; with the last lines that it wrote.
    """
    command = [sys.executable, "-m", "infomap_ros.nodes.live.kernels"]
    lines: list[str] = []
    with subprocess.Popen(
        command, text=True, stdout=subprocess.PIPE, stderr=subprocess.STDOUT
    ) as process:
        for line in process.stdout or ():
            lines.append(line.rstrip())
            if lines[-1] in STEPS:
                number = list(STEPS).index(lines[-1]) + 1
                tell(f"{number} of {len(STEPS)}, {lines[-1]}")
    if process.returncode:
        raise ProcessError("kernels cannot be compiled:\n  " + "\n  ".join(lines[-5:]))


def main() -> int:
    """Compile everything; prints each step's name before it."""
    for name, compile_them in STEPS.items():
        print(name, flush=True)
        compile_them()
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
