"""What commands a moving arm and base is killed or hangs: both stop, and nobody answers for it."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
import time
from collections import ChainMap
from typing import Any

import numpy as np
import pytest
from nav_msgs.msg import Path
from trajectory_msgs.msg import JointTrajectory

from infomap_ros.messages.motions import encode_arm_trajectory, encode_base_path
from infomap_ros.motion.route import ArmPath
from infomap_ros.nodes.common.environment import process_environment
from infomap_ros.nodes.common.message_types import RclpyMessageTypes
from infomap_ros.nodes.driving import watchdog

from .controllers import TrajectoryController, VelocityController
from .rovers import PaperRover
from .test_robot_driver import ARM, NEEDS_ACTIONS

TYPES = RclpyMessageTypes()
HUNG = "has given no sign of life for"


class Moving:
    """A driver in a process of its own that moves the arm and a base that obeys its last order."""

    def __init__(self, graph: Any, arm: str) -> None:
        self.graph, self.rover = graph, PaperRover(graph)
        self.rover.obeys = self.rover.moves_arm = False
        self.base = VelocityController(self.rover)
        self.base.patience = np.inf
        joints = dict.fromkeys(ARM, 0.1)
        self.arm = TrajectoryController(graph, "arm_controller", joints, False)
        self.rover.joints = ChainMap(joints, self.rover.joints)
        self.paths = graph.publisher(Path, "base_path")
        self.trajectories = graph.publisher(JointTrajectory, "arm_trajectory")
        table = f"controllers:=['arm_controller: {', '.join(ARM)}']"
        command = [sys.executable, "-m", "infomap_ros.nodes.robot_driver", "--ros-args"]
        command += ["-r", f"__ns:={graph.namespace}", "-p", "base:=cmd_vel", "-p", table]
        command += ["-p", f"arm:={arm}"]
        environment = os.environ | process_environment() | {"ROS_DOMAIN_ID": str(graph.domain)}
        self.process = subprocess.Popen(command, env=environment)
        self._sent = 0.0
        graph.spin_until(self._is_watched, "the watchdog", 60.0)
        graph.spin_until(self._moves, "arm and base", 60.0)

    def _is_watched(self) -> bool:
        return "robot_driver_watchdog" in self.graph.tester.get_node_names()

    def _moves(self) -> bool:
        if time.monotonic() > self._sent + 1.0:
            self._sent = time.monotonic()
            poses = np.column_stack([np.linspace(0.0, 5.0, 51), np.zeros((51, 2))])
            if self.base.pose[0] == 0.0:
                self.paths.publish(encode_base_path(TYPES, 1, "map", poses))
            if not self.arm.moves:
                knots = np.array([[0.1] * 3, [1.0] * 3])
                path = ArmPath(ARM, knots, np.array([0.0, 30.0]))
                self.trajectories.publish(encode_arm_trajectory(TYPES, 0, path))
        return bool(self.arm.moves and self.base.pose[0] > 0.2)


@NEEDS_ACTIONS
@pytest.mark.parametrize("arm", ["follow_joint_trajectory", "joint_trajectory"])
@pytest.mark.parametrize("fault", [signal.SIGKILL, signal.SIGTERM, signal.SIGSTOP])
def test_the_robot_stops_when_its_driver_is_gone(
    graph: Any, fault: signal.Signals, arm: str
) -> None:
    moving = Moving(graph, arm)
    try:
        before, place = moving.arm.joints[ARM[0]], moving.base.pose[0]
        moving.process.send_signal(fault)
        graph.spin_until(
            lambda: not moving.arm.moves and moving.base.commands[-1] == (0.0, 0.0), "standstill"
        )
        assert moving.arm.canceled == (arm == "follow_joint_trajectory")
        assert abs(moving.arm.joints[ARM[0]] - before) < 0.1  # of 0.9 rad that were left
        assert moving.base.pose[0] - place < 1.0  # of 5 m
    finally:
        moving.process.kill()
        moving.process.wait()


@NEEDS_ACTIONS
@pytest.mark.parametrize("fault", [signal.SIGKILL, signal.SIGSTOP])
def test_the_robot_stops_when_its_explorer_is_gone(graph: Any, fault: signal.Signals) -> None:
    command = [sys.executable, "-m", "infomap_ros.nodes.explorer", "--ros-args"]
    command += ["-r", f"__ns:={graph.namespace}"]
    environment = os.environ | process_environment() | {"ROS_DOMAIN_ID": str(graph.domain)}
    explorer = subprocess.Popen(command, env=environment)
    try:
        topic = f"{graph.namespace}/exploration_status"
        graph.spin_until(lambda: graph.tester.count_publishers(topic) == 1, "the explorer", 60.0)
        moving = Moving(graph, "follow_joint_trajectory")
        try:
            graph.spin_until(lambda: moving.base.pose[0] > 0.4, "a base that goes on")
            place, since = moving.base.pose[0], time.monotonic()
            explorer.send_signal(fault)
            graph.spin_until(
                lambda: not moving.arm.moves and moving.base.commands[-1] == (0.0, 0.0),
                "standstill",
            )
            assert moving.arm.canceled
            assert moving.base.pose[0] - place < 1.5  # of 5 m
            assert time.monotonic() - since < 10.0  # the path would take longer
        finally:
            moving.process.kill()
            moving.process.wait()
    finally:
        explorer.kill()
        explorer.wait()


class Pipe:
    """What the watchdog hears of a driver, and what it does then."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, patience: float) -> None:
        heard, self._said = os.pipe()
        self.stops: list[str] = []
        monkeypatch.setattr(watchdog, "_PATIENCE", patience)
        monkeypatch.setattr(sys, "stdin", os.fdopen(heard, "rb"))
        self.thread = threading.Thread(target=watchdog._watch, args=(self,), daemon=True)
        self.thread.start()

    def stop(self, why: str) -> None:
        self.stops.append(why)

    def say(self, words: bytes) -> None:
        os.write(self._said, words)

    def end(self) -> list[str]:
        """The driver's end of the pipe is closed; returns what was done, and why."""
        os.close(self._said)
        self.thread.join(20.0)
        assert not self.thread.is_alive()
        return self.stops


@pytest.mark.parametrize("words", [b"", b"r", b"rrm", b"mmr"])
def test_an_end_without_farewell_stops_before_any_patience(
    monkeypatch: pytest.MonkeyPatch, words: bytes
) -> None:
    pipe = Pipe(monkeypatch, patience=1e6)
    pipe.say(words)
    assert pipe.end() == ["is gone"]


@pytest.mark.parametrize("words", [b"f", b"mf", b"rf"])
def test_a_farewell_stops_nothing(monkeypatch: pytest.MonkeyPatch, words: bytes) -> None:
    pipe = Pipe(monkeypatch, patience=1e6)
    pipe.say(words)
    pipe.thread.join(20.0)
    assert pipe.end() == []


def test_silence_stops_a_motion_once_and_rest_never(monkeypatch: pytest.MonkeyPatch) -> None:
    pipe = Pipe(monkeypatch, patience=0.05)
    for words, stops in ((b"r", 0), (b"m", 1), (b"r", 1), (b"m", 2)):
        pipe.say(words)
        end = time.monotonic() + 20.0
        while len(pipe.stops) < stops and time.monotonic() < end:
            time.sleep(0.01)
        time.sleep(0.2)  # four times the patience
        assert len(pipe.stops) == stops
    pipe.say(b"f")
    pipe.end()
    assert all(why.startswith(HUNG) for why in pipe.stops)
