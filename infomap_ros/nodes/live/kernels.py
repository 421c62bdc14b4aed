"""Compile what the nodes need once, before several processes need it at the same time.

Each node would compile by itself what is not in the cache yet, and several need the same. Where all
is in the cache, this takes some seconds.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from typing import Self

import numpy as np

from infomap_ros.errors import ProcessError
from infomap_ros.exploration.view_planner_config import ViewPlannerConfig
from infomap_ros.geometry import PinholeCamera
from infomap_ros.mapping import VoxelMap, VoxelMapConfig
from infomap_ros.nodes.fusion import map_keeper
from infomap_ros.nodes.locating import localization_config
from infomap_ros.nodes.planning import plan_warm_up
from infomap_ros.pipeline.range_estimator import StereoRangeEstimator
from infomap_ros.stereo import DepthCameraSensor, StereoConfig
from infomap_ros.team.config import TeamConfig
from infomap_ros.team.member import TeamMember

Stages = tuple[tuple[tuple[str, ...], ...], ...]

_POLL = 0.1  # [s]


def _share() -> None:
    """Two robots send each other the same small map, and lose every third update."""
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
            for rows in me.updates(own_map, now):
                count += 1
                if count % 3:
                    other.receive_update(rows, now)
            for rows in me.digests(now):
                other.receive_digest(rows, now)
            for rows in me.requests(now):
                other.receive_request(rows, now)
    for robot in robots:
        robot.replica.hash()


def _measure() -> None:
    """Measure as both kinds of camera do."""
    StereoRangeEstimator(StereoConfig(), rectify=True).warm_up()
    camera = PinholeCamera(64, 48, 60.0, 60.0, 31.5, 23.5)
    DepthCameraSensor(camera).measure(np.full((48, 64), 1.0))


STEPS: Mapping[str, Callable[[], object]] = {
    "range": _measure,
    "map": lambda: map_keeper.warm_up(1),
    "sharing": _share,
    "localization": localization_config.warm_up,
    "planning": lambda: plan_warm_up.warm_up(ViewPlannerConfig(threads=1)),
}
"""What is compiled, by name. Localization and map use range; sharing and planning use the map."""

SENSING: Stages = ((("range",),), (("map",), ("localization",)))
"""What the nodes need that make a map: stages, one after the other, of groups, each a process."""
PLANNING = ("planning",)
"""What choosing a view needs, after `SENSING`."""
TEAM: Stages = (*SENSING, (PLANNING, ("sharing",)))
"""What all nodes of robots need that share a map."""


class KernelProcess:
    """Compiles some of `STEPS` in a process of its own, whose memory is gone afterwards; a context.

    No kernel may be compiled by two of them at once: of two writers of one file in the cache the
    later one wins, and what the other has compiled is compiled again.

    Args:
        steps: names, in their order.
    """

    def __init__(self, steps: Sequence[str]) -> None:
        self._output = tempfile.TemporaryFile("w+")  # noqa: SIM115 (closed in __exit__)
        self._process = subprocess.Popen(
            [sys.executable, "-m", "infomap_ros.nodes.live.kernels", *steps],
            stdout=self._output,
            stderr=subprocess.STDOUT,
        )

    @property
    def done(self) -> bool:
        """Whether everything is compiled.

        Raises:
            ProcessError: it failed; with the last lines that it wrote.
        """
        status = self._process.poll()
        if status:
            self._output.seek(0)
            lines = self._output.read().splitlines()[-5:]
            raise ProcessError("kernels cannot be compiled:\n  " + "\n  ".join(lines))
        return status is not None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        if self._process.poll() is None:
            self._process.kill()
        self._process.wait()
        self._output.close()


def compile_kernels(report: Callable[[str], None], stages: Stages) -> None:
    """Compile what is not in the cache yet, the groups of a stage at the same time.

    Args:
        report: called with each stage before it begins.
        stages: of names in `STEPS`.

    Raises:
        ProcessError: it failed; with the last lines that a process wrote.
    """
    for number, groups in enumerate(stages, 1):
        names = " and ".join(", ".join(steps) for steps in groups)
        report(f"{number} of {len(stages)}, {names}")
        with ExitStack() as stack:
            processes = [stack.enter_context(KernelProcess(steps)) for steps in groups]
            while [process for process in processes if not process.done]:
                time.sleep(_POLL)


def main(steps: Sequence[str]) -> int:
    """Compile steps, in their order; all of them, in two processes, where none is named."""
    if not steps:
        compile_kernels(print, TEAM)
    for name in steps:
        STEPS[name]()
    return 0


if __name__ == "__main__":
    raise SystemExit(main(sys.argv[1:]))
