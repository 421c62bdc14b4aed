"""Robots find each other by a Fast DDS discovery server where multicast does not pass."""

from __future__ import annotations

import os
import random
import socket
import subprocess
import sys
from pathlib import Path

ROBOT = """
import sys, time
import numpy as np
import rclpy
from sensor_msgs.msg import PointCloud2
from infomap_ros.nodes.common import qos
from infomap_ros.nodes.common.message_types import RclpyMessageTypes
from infomap_ros.messages.rows import decode_rows, encode_rows
from infomap_ros.team.update import MapUpdate
from infomap_ros.team.wire import decode_update, encode_update

robot = int(sys.argv[1])
rclpy.init()
node = rclpy.create_node(f"robot_{robot}")
heard = []
node.create_subscription(PointCloud2, "team/map_updates", heard.append, qos.stream(10))
publisher = node.create_publisher(PointCloud2, "team/map_updates", qos.stream(10))
one = np.ones(1, np.uint32), np.zeros((1, 3), np.int32), np.ones(1, np.int8)
update = MapUpdate(0.05, robot, *one, np.zeros((1, 2), np.uint64))
(rows,) = encode_update(update)
end, robots = time.monotonic() + 60.0, set()
while time.monotonic() < end and robots != {1, 2}:
    publisher.publish(encode_rows(RclpyMessageTypes(), 0, "map", rows))
    rclpy.spin_once(node, timeout_sec=0.1)
    robots |= {decode_update(decode_rows(message)[2]).robot for message in heard}
for _ in range(20):  # the other one may still wait for this one's word
    publisher.publish(encode_rows(RclpyMessageTypes(), 0, "map", rows))
    rclpy.spin_once(node, timeout_sec=0.05)
print(sorted(robots))
"""


def test_robots_hear_each_other_by_a_discovery_server() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    tool = Path(sys.executable).parent / "fastdds"
    command = [str(tool) if tool.exists() else "fastdds", "discovery", "-i", "0"]
    server = subprocess.Popen(
        [*command, "-l", "127.0.0.1", "-p", str(port)],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        start_new_session=True,
    )
    environment = os.environ | {
        "ROS_DISCOVERY_SERVER": f"127.0.0.1:{port}",
        "ROS_DOMAIN_ID": str(random.randrange(1, 100)),
    }
    environment.pop("ROS_LOCALHOST_ONLY", None)
    environment.pop("ROS_AUTOMATIC_DISCOVERY_RANGE", None)
    try:
        robots = [
            subprocess.Popen(
                [sys.executable, "-c", ROBOT, number], env=environment, stdout=subprocess.PIPE
            )
            for number in ("1", "2")
        ]
        answers = [robot.communicate(timeout=100)[0].decode().strip() for robot in robots]
    finally:
        os.killpg(server.pid, 15)
        server.wait(20)

    assert answers == ["[1, 2]", "[1, 2]"]
