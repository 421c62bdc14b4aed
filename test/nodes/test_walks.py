"""How many files of the package one pixel and one choice pass; it may become fewer, not more.

Compiled kernels are not seen: the files of what calls them are counted.
"""

from __future__ import annotations

import sys
import threading
from collections.abc import Iterator
from pathlib import Path
from types import FrameType
from typing import Any

import numpy as np
import pytest

import infomap_ros
from infomap_ros.geometry import StereoRig
from infomap_ros.mapping import VoxelMap
from infomap_ros.motion.robot.robot_model import RobotModel
from infomap_ros.stereo import StereoRangeSensor
from test.exploration.test_view_planner import box_of_voxels, planner_of, robot, standing
from test.nodes.test_map_fusion import CAMERA, START, T_MAP_CAMERA, Bench, cloud, pose

PACKAGE = str(Path(infomap_ros.__file__).parent)
MOST = {"measure": 7, "integrate": 17, "cloud to map_updates": 60, "choose": 76}
"""Files; to be lowered with each that goes."""

__all__ = ["robot"]  # a fixture of the tests of the planner


class Walk:
    """The files that are entered while it is open, in any thread that began after it was made."""

    def __init__(self) -> None:
        self.files: set[str] = set()
        self.is_open = False

    def see(self, frame: FrameType, event: str, argument: Any) -> None:
        """For sys.setprofile."""
        code = frame.f_code
        is_call = self.is_open and event == "call" and code.co_name != "<module>"
        if is_call and code.co_filename.startswith(PACKAGE):
            self.files.add(code.co_filename[len(PACKAGE) + 1 :])

    def check(self, name: str) -> None:
        self.is_open = False
        print(f"{name}: {len(self.files)} files, at most {MOST[name]}", *sorted(self.files))
        assert len(self.files) <= MOST[name]


@pytest.fixture
def walk() -> Iterator[Walk]:
    seen = Walk()
    sys.setprofile(seen.see)
    threading.setprofile(seen.see)
    yield seen
    sys.setprofile(None)
    threading.setprofile(None)  # type: ignore[arg-type]


def test_measure(walk: Walk, rng: np.random.Generator) -> None:
    pattern = rng.integers(0, 255, (120, 200), np.uint8)
    images = pattern[:, 20:180].copy(), pattern[:, 28:188].copy()
    camera = type(CAMERA)(160, 120, 110.0, 110.0, 79.5, 59.5)
    sensor = StereoRangeSensor(StereoRig(camera, camera, 0.1))
    walk.is_open = True
    assert sensor.measure(*images).density > 0.5
    walk.check("measure")


def test_integrate(walk: Walk) -> None:
    voxel_map, scan = VoxelMap(), cloud()
    walk.is_open = True
    voxel_map.integrate(scan.points, T_MAP_CAMERA, scan.covariances, camera=CAMERA)
    walk.check("integrate")


def test_cloud_to_map_updates(graph: Any, walk: Walk) -> None:
    bench = Bench(graph)
    bench.send(pose(), cloud())
    bench.wait_for_updates(START)
    walk.is_open = True
    bench.send(pose(START + 10**9), cloud(START + 10**9, depth=1.5))
    bench.wait_for_updates(START + 10**9)
    walk.check("cloud to map_updates")


def test_choose(robot: RobotModel, walk: Walk) -> None:
    planner, voxel_map, state = planner_of(robot), box_of_voxels(-10, 0.001), standing(robot)
    walk.is_open = True
    assert planner.choose(voxel_map, state).pose is not None
    walk.check("choose")
