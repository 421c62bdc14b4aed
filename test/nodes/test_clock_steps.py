"""The clock of the machine is stepped while the driver drives a base that obeys its last order."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from nav_msgs.msg import Path as PathMessage

from infomap_ros.messages.motions import encode_base_path
from infomap_ros.nodes.common.environment import process_environment
from infomap_ros.nodes.common.message_types import RclpyMessageTypes

from .controllers import VelocityController
from .rovers import PaperRover

TYPES = RclpyMessageTypes()
LENGTH = 0.8  # of each drive [m]
STEPS = (-10, -3600, 3600)  # [s]
SHIM = r"""
#define _GNU_SOURCE
#include <dlfcn.h>
#include <stdio.h>
#include <stdlib.h>
#include <time.h>
int clock_gettime(clockid_t clock, struct timespec *now) {
  static int (*original)(clockid_t, struct timespec *);
  if (!original) *(void **)&original = dlsym(RTLD_NEXT, "clock_gettime");
  int result = original(clock, now);
  if (clock == CLOCK_REALTIME) {
    long step = 0;
    FILE *file = fopen(getenv("CLOCK_STEP"), "r");
    if (file) { if (fscanf(file, "%ld", &step) != 1) step = 0; fclose(file); }
    now->tv_sec += step;
  }
  return result;
}
"""


@pytest.fixture
def driver(graph: Any, tmp_path: Path) -> Iterator[Path]:
    """robot_driver as a process; the file that says by how many seconds its clock is off."""
    compiler = shutil.which("cc") or shutil.which("gcc")
    if compiler is None or sys.platform != "linux":
        pytest.skip("needs a C compiler and the loader of Linux")
    source, library, step = tmp_path / "shim.c", tmp_path / "shim.so", tmp_path / "step"
    source.write_text(SHIM)
    subprocess.run([compiler, "-shared", "-fPIC", "-o", library, source, "-ldl"], check=True)
    step.write_text("0")
    environment = os.environ | process_environment() | {
        "LD_PRELOAD": str(library), "CLOCK_STEP": str(step), "ROS_DOMAIN_ID": str(graph.domain),
    }  # fmt: skip
    command = [sys.executable, "-m", "infomap_ros.nodes.robot_driver", "--ros-args"]
    command += ["-r", f"__ns:={graph.namespace}", "-p", "base:=cmd_vel", "-p", "arm:=none"]
    with subprocess.Popen(command, env=environment) as process:
        yield step
        process.terminate()


def test_a_stepped_clock_neither_stops_a_drive_nor_lets_it_run_on(graph: Any, driver: Path) -> None:
    rover = PaperRover(graph)
    base, paths = VelocityController(rover), graph.publisher(PathMessage, "base_path")
    base.patience, rover.obeys, rover.stamp = np.inf, False, 1_700_000_000_000_000_000
    graph.spin_until(paths.get_subscription_count, "the driver", 60.0)
    off, sent = 0, [0.0]
    for number, step in enumerate(STEPS, 1):
        start, told = base.pose[0], len(base.commands)
        path = start + np.linspace(0.0, LENGTH, 9)
        poses = np.column_stack([path, np.zeros((9, 2))])

        def drives(start: float = start, poses: Any = poses, number: int = number) -> bool:
            if base.pose[0] <= start and time.monotonic() > sent[0] + 1.0:
                sent[0] = time.monotonic()
                paths.publish(encode_base_path(TYPES, number, "map", poses))
            return bool(base.pose[0] > start + 0.2)

        graph.spin_until(drives, f"drive {number}")
        off += step
        driver.write_text(str(off))
        rover.stamp += step * 1_000_000_000

        def stands(told: int = told) -> bool:
            return len(base.commands) > told and base.commands[-1] == (0.0, 0.0)

        graph.spin_until(stands, f"the end of drive {number}, by {step} s")
        assert 0.0 < base.pose[0] - start < LENGTH + 0.3
