"""A process ends although C code keeps Python's lock for ever, as Fast DDS may at the end."""

from __future__ import annotations

import subprocess
import sys
import time

import pytest

HELD = """
import ctypes
from infomap_ros.nodes.common.interrupts import exit_within, part_soon
{leave}
print("saved", end="")
ctypes.PyDLL(None).sleep({seconds})  # with the lock
raise SystemExit(3)
"""


def run(leave: str, seconds: int) -> subprocess.CompletedProcess[str]:
    program = HELD.format(leave=leave, seconds=seconds)
    command = [sys.executable, "-u", "-c", program]
    return subprocess.run(command, capture_output=True, text=True, timeout=100.0, check=False)


@pytest.mark.skipif(sys.platform != "linux", reason="a timer of Linux")
def test_what_holds_the_lock_does_not_hold_the_process() -> None:
    begin = time.monotonic()
    ended = run("exit_within(0.3)", 60)

    assert (ended.returncode, ended.stdout) == (0, "saved")
    assert time.monotonic() - begin < 55.0


def test_a_process_that_runs_no_node_is_left_alone() -> None:
    assert run("part_soon()", 7).returncode == 3
