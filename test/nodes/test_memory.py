"""A node's memory is ready before the first message."""

from __future__ import annotations

import subprocess
import sys

COUNT = """
import resource
from infomap_ros.nodes.common.memory import *

def new_pages(work):
    before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
    work()
    return resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before

def four_clouds():
    return [b"x" * 12_000_000 for _ in range(4)]
"""


def run(program: str) -> list[int]:
    script = COUNT + program
    command = [sys.executable, "-c", script]
    done = subprocess.run(command, text=True, capture_output=True, check=True)
    return [int(word) for word in done.stdout.split()]


def test_memory_that_is_reserved_is_used_by_messages_of_any_thread() -> None:
    pages = run("""
import threading
import rclpy  # starts threads, with which the worker below might share another heap
reserve_heap(MemoryConfig(reserved_memory=64.0))
print(new_pages(four_clouds))
thread = threading.Thread(target=lambda: print(new_pages(four_clouds)))
thread.start()
thread.join()
""")

    assert max(pages) < 300, "of 11719"


def test_freed_memory_is_kept() -> None:
    first, second = run("""
print(new_pages(four_clouds), new_pages(four_clouds))
""")

    assert first > 2000
    assert second < 300


def test_what_is_in_use_of_the_heap_grows_by_what_is_taken_and_falls_by_what_is_freed() -> None:
    before, during, after = run("""
reserve_heap(MemoryConfig(reserved_memory=64.0))
before = heap_in_use()
clouds = four_clouds()
during = heap_in_use()
clouds.clear()
print(before, during, heap_in_use())
""")

    assert 48_000_000 <= during - before < 49_000_000
    assert abs(after - before) < 1_000_000


def test_shared_memory_of_the_middleware_is_found_and_used() -> None:
    (size,) = run("""
import os
import random
from infomap_ros.nodes.common.environment import additions
os.environ.update(additions(), ROS_DOMAIN_ID=str(random.randint(1, 100)))
os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
import rclpy
rclpy.init()
node = rclpy.create_node("memory")
print(use_shared_memory())
node.destroy_node()
rclpy.shutdown()
""")

    assert size > 500_000, "the segment of this process"
