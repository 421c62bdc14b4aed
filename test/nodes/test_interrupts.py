"""Each program that runs a node ends in order, and soon, when it is interrupted."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest
from diagnostic_msgs.msg import DiagnosticArray

from infomap_ros.nodes.common.interrupts import EXECUTABLES

from .test_documented_nodes import GIVEN

LONGEST = 3.0  # [s]; 1 s on an idle machine, and tests may run beside


@pytest.mark.parametrize("name", EXECUTABLES)
def test_a_node_that_waits_for_its_inputs_ends_when_it_is_told_to(
    name: str, graph: Any, tmp_path: Path
) -> None:
    said = graph.collect(DiagnosticArray, "/diagnostics")
    # The explorer has a mission that waits, the player somebody to wait for.
    extra = {"explorer": {"autostart": True}, "bag_player": {"wait_for_subscribers": ["points2"]}}
    given = {**GIVEN.get(name, {}), **extra.get(name, {})}
    command = [sys.executable, "-m", f"infomap_ros.nodes.{name}", "--ros-args"]
    for key, value in given.items():
        command += ["-p", f"{key.replace('__', '.')}:={json.dumps(value)}"]
    command += ["-r", f"__ns:={graph.namespace}"]
    own, environment = f"{graph.namespace}/{name}", graph.environment()
    with (tmp_path / "log").open("wb") as log:
        process = subprocess.Popen(command, cwd=tmp_path, env=environment, stdout=log, stderr=log)
    try:
        graph.spin_until(
            lambda: any(status.hardware_id == own for array in said for status in array.status),
            f"{name} to spin",
            240.0,
        )
        begin = time.monotonic()
        process.send_signal(signal.SIGINT)
        status = process.wait(20.0)
        took = time.monotonic() - begin
    finally:
        process.kill()
    text = (tmp_path / "log").read_text("utf-8")
    assert (status, "Traceback" in text) == (0, False), text[-2000:]
    assert took < LONGEST
