"""Some thousand messages of `benchmarks/fuzz_nodes.py`: nothing odd lasts."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

from infomap_ros.nodes.robot.robot_tracker import RobotTracker

from .conftest import random_domain

SCRIPT = Path(__file__).resolve().parent.parent.parent / "benchmarks" / "fuzz_nodes.py"


@pytest.fixture
def fuzzer(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    monkeypatch.setenv("ROS_DOMAIN_ID", str(random_domain()))
    spec = importlib.util.spec_from_file_location("fuzz_nodes", SCRIPT)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    monkeypatch.setitem(sys.modules, "fuzz_nodes", module)
    spec.loader.exec_module(module)
    return module


def test_nothing_odd_lasts_in_any_node(fuzzer: ModuleType) -> None:
    figures = fuzzer.check(20.0, seed=11)
    assert figures["topics"] >= 30
    assert figures["odd"] > 20


def test_a_node_that_believes_the_latest_stamp_for_ever_is_found(
    fuzzer: ModuleType, monkeypatch: pytest.MonkeyPatch
) -> None:
    take, newest = RobotTracker._on_joints, [0]

    def take_the_newest(tracker: RobotTracker, message: Any) -> None:
        stamp = message.header.stamp.sec
        newest[0] = max(newest[0], stamp)
        if stamp == newest[0]:
            take(tracker, message)

    monkeypatch.setattr(RobotTracker, "_on_joints", take_the_newest)
    with pytest.raises(AssertionError, match="joints"):
        fuzzer.check(120.0, seed=3)
