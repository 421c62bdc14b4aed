"""Two hosts, a bad cable between them, a discovery server: one map.

The hosts are network namespaces. Where this machine does not allow them, the test says so.
"""

from __future__ import annotations

import os
import random
import shutil
import socket
import subprocess
import sys
import time
from pathlib import Path

import pytest

from .lossy_link import LossyLink

LOSS, DELAY = 0.2, 0.02
PORT = 11811
ROBOT = """
import sys, time
import numpy as np
import rclpy
from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import PointCloud2
from infomap_ros.mapping import VoxelMap, VoxelMapConfig
from infomap_ros.nodes.common.message_types import RclpyMessageTypes
from infomap_ros.messages.rows import decode_rows, encode_rows
from infomap_ros.team.config import TeamConfig
from infomap_ros.team.member import TeamMember

robot, types = int(sys.argv[1]), RclpyMessageTypes()
config = VoxelMapConfig(voxel_size=0.1)
own = VoxelMap(config)
own.track_changes(True)
wall = np.random.default_rng(robot).uniform((2.0, -1.5, -1.0), (2.05, 1.5, 1.0), (3000, 3))
for _ in range(2):
    own.integrate(wall + (0.0, 0.0, 3.0 * robot), np.eye(4))
sharing = TeamConfig(message_size=1300, recovery=0.0, bandwidth=1.0)
member = TeamMember(robot, robot, 1000, config, sharing)
rclpy.init()
node = rclpy.create_node(f"robot_{robot}")
best_effort = QoSProfile(depth=1000, reliability=ReliabilityPolicy.BEST_EFFORT)
handlers = {
    "map_updates": member.receive_update,
    "digests": member.receive_digest,
    "requests": member.receive_request,
}
speak = {}
for topic, listen in handlers.items():
    def receive(message, listen=listen):
        listen(decode_rows(message)[2], time.monotonic())
    node.create_subscription(PointCloud2, f"team/{topic}", receive, best_effort)
    speak[topic] = node.create_publisher(PointCloud2, f"team/{topic}", best_effort)
while not all(publisher.get_subscription_count() > 1 for publisher in speak.values()):
    rclpy.spin_once(node, timeout_sec=0.05)
print("connected", flush=True)
spoken = 0.0
while True:
    now = time.monotonic()
    messages = {"map_updates": member.updates(own, now)}
    if now - spoken > sharing.digest_period:
        spoken = now
        messages |= {"digests": member.digests(now), "requests": member.requests(now)}
        print(f"{member.replica.hash():x} {len(member.replica.robots)}", flush=True)
    for topic, parts in messages.items():
        for rows in parts:
            speak[topic].publish(encode_rows(types, 0, "map", rows))
    end = time.monotonic() + 0.02
    while time.monotonic() < end:
        rclpy.spin_once(node, timeout_sec=0.005)
"""


def _why_not() -> str:
    """Why there can be no hosts on this machine; empty where there can."""
    if shutil.which("ip") is None:
        return "the ip tool of iproute2 is not installed"
    if not hasattr(socket, "AF_PACKET") or os.geteuid() != 0:
        return "network namespaces need Linux and the rights of root"
    try:
        with LossyLink(0.0, 0.0):
            return ""
    except (OSError, subprocess.CalledProcessError) as error:
        return f"this machine allows no network namespaces: {getattr(error, 'stderr', error)}"


@pytest.fixture(scope="module")
def hosts_are_possible() -> None:
    if reason := _why_not():
        pytest.skip(reason)


@pytest.mark.usefixtures("hosts_are_possible")
def test_two_hosts_with_a_bad_cable_hold_the_same_map(tmp_path: Path) -> None:
    tool = Path(sys.executable).parent / "fastdds"
    environment = os.environ | {
        "ROS_DISCOVERY_SERVER": f"10.77.0.1:{PORT}",
        "ROS_DOMAIN_ID": str(random.randrange(1, 100)),
        "FASTDDS_BUILTIN_TRANSPORTS": "UDPv4",  # or both hosts would find the same shared memory
    }
    for name in ("ROS_LOCALHOST_ONLY", "ROS_AUTOMATIC_DISCOVERY_RANGE"):
        environment.pop(name, None)
    server = [str(tool) if tool.exists() else "fastdds", "discovery", "-i", "0"]
    said = [tmp_path / f"robot_{number}.txt" for number in (1, 2)]
    processes: list[subprocess.Popen[bytes]] = []
    with LossyLink(LOSS, DELAY) as link:
        try:
            command = link.command(0, *server, "-l", "10.77.0.1", "-p", str(PORT))
            processes.append(_start(command, tmp_path / "server.txt", environment))
            for host, path in enumerate(said):
                command = link.command(host, sys.executable, "-c", ROBOT, str(host + 1))
                processes.append(_start(command, path, environment))
            _wait_until_the_same(said, processes, 240.0)
        finally:
            for process in processes:
                os.killpg(process.pid, 9)
                process.wait(20)
    assert link.carried > 100
    assert link.lost / (link.lost + link.carried) == pytest.approx(LOSS, abs=0.08)


def _start(command: list[str], out: Path, environment: dict[str, str]) -> subprocess.Popen[bytes]:
    with out.open("wb") as file:
        return subprocess.Popen(
            command, env=environment, stdout=file, stderr=file, start_new_session=True
        )


def _wait_until_the_same(
    said: list[Path], processes: list[subprocess.Popen[bytes]], timeout: float
) -> None:
    end = time.monotonic() + timeout
    while True:
        last = [(path.read_text().splitlines() or [""])[-1] for path in said]
        if last[0] == last[1] and last[0].endswith(" 2"):
            return
        assert all(process.poll() is None for process in processes), last
        assert time.monotonic() < end, last
        time.sleep(0.1)
