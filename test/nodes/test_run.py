"""A node ends in order when it is told to, even if it is told twice."""

from __future__ import annotations

import signal
import subprocess
import sys
from pathlib import Path

import pytest

from infomap_ros import nodes
from infomap_ros.nodes.common.interrupts import EXECUTABLES
from infomap_ros.nodes.live.live_graph import private_graph

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


def test_every_program_that_runs_a_node_is_known() -> None:
    folder = Path(nodes.__file__).parent
    running = {path.stem for path in folder.glob("*.py") if "run_node(" in path.read_text()}

    assert running == set(EXECUTABLES)


STARTING = """
import sys, time
sys.argv[0] = "/opt/lib/infomap_ros/map_fusion"
import infomap_ros.nodes
print("imports", flush=True)
if "import" in sys.argv:
    time.sleep(60.0)
from infomap_ros.nodes.common.base import MonitoredNode
from infomap_ros.nodes.common.run import run_node

class Compiles(MonitoredNode):
    def __init__(self):
        super().__init__("compiles")
        print("compiles", flush=True)
        time.sleep(60.0)

raise SystemExit(run_node(Compiles, []))
"""


@pytest.mark.parametrize("state", ["imports", "compiles"])
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_an_interrupt_while_starting_ends_at_once_and_quietly(
    state: str, number: signal.Signals
) -> None:
    words = ["import"] if state == "imports" else []
    command = [sys.executable, "-c", STARTING, *words]
    options = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    with subprocess.Popen(command, **options, env=private_graph()) as process:
        assert process.stdout is not None
        while process.stdout.readline().strip() != state:
            assert process.poll() is None
        process.send_signal(number)
        _, said = process.communicate(timeout=10.0)

    assert (process.returncode, said) == (0, "")
