"""What a publisher of clouds keeps of its heap while subscribers stand still, and afterwards.

A reliable publisher keeps each cloud until every subscriber has acknowledged it, as many as its
depth at the most, and Fast DDS keeps the memory of as many as it ever kept at once for the next
ones. A subscriber in a process of its own is stopped for longer and longer; each time some more
clouds are published once it goes on. Prints one JSON line.

    FASTRTPS_DEFAULT_PROFILES_FILE=config/fastdds.xml python benchmarks/publisher_memory.py
"""

from __future__ import annotations

import argparse
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress

import numpy as np
import rclpy
from rclpy.executors import ExternalShutdownException
from sensor_msgs.msg import PointCloud2

import infomap_ros.nodes  # noqa: F401  sets how memory is used, as for the nodes
from infomap_ros.nodes.common import qos
from infomap_ros.nodes.common.memory import heap_in_use

CLOUD = 640 * 480 * 40  # [bytes], as stereo_range publishes it
DEPTH, PERIOD, PAUSES = 5, 0.2, (0.5, 1.0, 2.0, 2.0)


def listen() -> None:
    """Receive clouds until the process is ended."""
    node = rclpy.create_node("listener")
    node.create_subscription(PointCloud2, "points2", lambda _: None, qos.stream())
    with suppress(ExternalShutdownException):
        rclpy.spin(node)


@contextmanager
def listener() -> Iterator[int]:
    """A subscriber in a process of its own; yields the process's number."""
    process = subprocess.Popen([sys.executable, __file__, "--listen"])
    try:
        yield process.pid
    finally:
        process.send_signal(signal.SIGCONT)
        process.terminate()
        process.wait()


def measure() -> dict[str, object]:
    """Megabytes in use after each pause."""
    node = rclpy.create_node("talker")
    publisher = node.create_publisher(PointCloud2, "points2", qos.stream(depth=DEPTH))

    def publish(count: int) -> None:
        for _ in range(count):
            publisher.publish(PointCloud2(data=np.zeros(CLOUD, np.uint8)))
            time.sleep(PERIOD)

    def in_use() -> float:
        time.sleep(0.5)
        return round((heap_in_use() or 0) / 1e6, 1)

    with listener() as pid:
        while not publisher.get_subscription_count():
            time.sleep(PERIOD)
        publish(10)
        before, after = in_use(), []
        for pause in PAUSES:
            os.kill(pid, signal.SIGSTOP)
            publish(round(pause / PERIOD))
            os.kill(pid, signal.SIGCONT)
            publish(5)
            after.append(in_use())
    return {"before_mb": before, "after_pauses_mb": after}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--listen", action="store_true", help="be the subscriber")
    options = parser.parse_args()
    rclpy.init()
    if options.listen:
        listen()
        return
    result = {"cloud_mb": CLOUD / 1e6, "depth": DEPTH, "pauses_s": PAUSES, **measure()}
    print(json.dumps({"benchmark": "publisher_memory", **result}))


if __name__ == "__main__":
    main()
