"""A node ends in order when it is told to, even if it is told twice."""

from __future__ import annotations

import signal
import subprocess
import sys

import pytest

from infomap_ros.nodes.live.processes import private_graph

PROGRAM = """
import time
import rclpy.node
from infomap_ros.nodes.common.run import run_node

class SlowToEnd(rclpy.node.Node):
    def __init__(self):
        super().__init__("slow_to_end")
        self.create_timer(0.01, lambda: print("spins", flush=True))

    def destroy_node(self):
        assert self.context.ok(), "the node could not say anything any more"
        print("ends", flush=True)
        end = time.monotonic() + 1.0
        while time.monotonic() < end:
            pass
        super().destroy_node()
        print("clean", flush=True)

raise SystemExit(run_node(SlowToEnd))
"""


@pytest.mark.parametrize("first", [signal.SIGINT, signal.SIGTERM])
def test_a_second_interrupt_does_not_break_off_the_end(first: signal.Signals) -> None:
    command = [sys.executable, "-c", PROGRAM]
    options = {"stdout": subprocess.PIPE, "text": True, "env": private_graph()}
    with subprocess.Popen(command, **options) as process:
        assert process.stdout is not None
        for word, number in (("spins", first), ("ends", signal.SIGINT)):
            while process.stdout.readline().strip() != word:
                assert process.poll() is None
            process.send_signal(number)
        rest = process.stdout.read().split()

    assert rest == ["clean"]
    assert process.returncode == 0
