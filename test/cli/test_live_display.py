"""``--live``: whoever has the address sees the run, until the user has seen enough."""

from __future__ import annotations

import json
import re
import signal
import subprocess
import sys
import threading
from importlib.metadata import version
from pathlib import Path

import pytest
from websockets.sync.client import connect
from websockets.typing import Subprotocol

from infomap_ros.geometry.resources import find_share


@pytest.mark.parametrize("command", ["map", "localize"])
def test_the_page_stays_until_ctrl_c(command: str, tmp_path: Path) -> None:
    bag, out = find_share("bags/rover_rocks"), tmp_path / "out"
    program = "from infomap_ros.cli.app import main; main()"
    arguments = [command, str(bag), "--out", str(out), "--live"]
    process = subprocess.Popen(
        [sys.executable, "-c", program, *arguments],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    guard = threading.Timer(300.0, process.kill)
    guard.start()
    assert process.stderr is not None
    try:
        lines = []
        for line in process.stderr:
            lines.append(line)
            if "stays until Ctrl-C" in line:
                break
        address = re.search(r"websocket=(\S+)", "".join(lines))
        assert address is not None, lines
        told = Subprotocol(f"viser-v{version('viser')}")
        with connect(address[1], subprotocols=[told], max_size=None) as page:
            assert page.recv(timeout=20.0)
        process.send_signal(signal.SIGINT)
        summary, _ = process.communicate(timeout=30.0)
    finally:
        guard.cancel()
        process.kill()

    assert process.returncode == 0
    assert json.loads(summary)
    assert "http://127.0.0.1:" in lines[0]
