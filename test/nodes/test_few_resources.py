"""map_fusion maps where the machine gives it few file handles, or next to no shared memory."""

from __future__ import annotations

import os
import resource
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from geometry_msgs.msg import PoseWithCovarianceStamped
from sensor_msgs.msg import PointCloud2

from infomap_ros.mapping import VoxelMap
from infomap_ros.messages import encode_point_cloud, encode_pose
from infomap_ros.nodes.common import qos
from infomap_ros.nodes.common.environment import process_environment
from infomap_ros.nodes.common.message_types import RclpyMessageTypes

from .conftest import TIMEOUT
from .test_map_fusion import SECOND, START, cloud, pose

TYPES = RclpyMessageTypes()
SMALL_SHM = 'unshare -m sh -c "mount -t tmpfs -o size=16k none /dev/shm && {}"'


def may_mount() -> bool:
    command = ["sh", "-c", SMALL_SHM.format("true")]
    return (
        bool(shutil.which("unshare"))
        and not subprocess.run(command, check=False, stderr=subprocess.DEVNULL).returncode
    )


def shared_memory(process: int) -> float:
    """What /dev/shm holds at most, as a process sees it [bytes]."""
    place = os.statvfs(f"/proc/{process}/root/dev/shm")
    return place.f_blocks * place.f_frsize


@pytest.mark.parametrize(
    ("limited", "files", "shm"),
    [
        ("ulimit -n 32; exec {}", 32, np.inf),
        ("ulimit -n 64; exec {}", 64, np.inf),
        pytest.param(
            SMALL_SHM.replace("{}", "exec {}"),
            np.inf,
            16384,
            marks=pytest.mark.skipif(not may_mount(), reason="needs the right to mount"),
        ),
    ],
)
def test_a_map_grows_and_is_saved(
    graph: Any, tmp_path: Path, limited: str, files: float, shm: float
) -> None:
    saved = tmp_path / "map.infomap"
    node = f"{sys.executable} -m infomap_ros.nodes.map_fusion --ros-args -r __ns:={graph.namespace}"
    node += f" -p voxel_size:=0.1 -p map_file:={saved}"
    environment = os.environ | process_environment() | {"ROS_DOMAIN_ID": str(graph.domain)}
    clouds = graph.publisher(PointCloud2, "points2")
    poses = graph.publisher(PoseWithCovarianceStamped, "camera_pose", depth=100)
    updates = graph.collect(PointCloud2, "map_updates", qos.stream(100))
    process = subprocess.Popen(["bash", "-c", limited.format(node)], env=environment)
    try:
        graph.connect(clouds, poses)
        sent = 0
        end = time.monotonic() + TIMEOUT
        # The node reads at best effort, and its side of a connection comes up after ours.
        while len(updates) < 3 and time.monotonic() < end:
            poses.publish(encode_pose(TYPES, pose(START + sent * SECOND)))
            clouds.publish(encode_point_cloud(TYPES, cloud(START + sent * SECOND)))
            sent += 1
            pause = time.monotonic() + 0.5
            graph.spin_until(lambda pause=pause: time.monotonic() > pause, "half a second")
        assert len(updates) >= 3
        assert resource.prlimit(process.pid, resource.RLIMIT_NOFILE)[0] <= files
        assert shared_memory(process.pid) <= shm
        process.send_signal(signal.SIGINT)
        assert process.wait(30.0) == 0
    finally:
        process.kill()
        process.wait(10.0)
    means = VoxelMap.load(saved).gaussians()[1]
    assert len(means) > 100
    assert np.abs(means[:, 0] - 2.0).max() < 0.01  # the wall
