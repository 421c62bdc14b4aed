"""The programs of docs/howto_one_node.md, as they stand there, beside the node of their command."""

from __future__ import annotations

import os
import re
import shlex
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from geometry_msgs.msg import Twist

from infomap_ros.errors import InfomapError
from infomap_ros.mapping.files.octomap_file import write_bt, write_ot
from infomap_ros.nodes.fiducial_localization import FiducialLocalizationNode
from infomap_ros.nodes.next_best_view import NextBestViewNode
from infomap_ros.nodes.robot_driver import RobotDriverNode

from .bag_stage import IMAGES, INFOS, BagStage
from .controllers import VelocityController
from .rovers import PaperRover, update_messages
from .test_next_best_view import QUICK

PAGE = Path(__file__).resolve().parents[2] / "docs/howto_one_node.md"
SECTIONS = dict(
    part.split("\n", 1) for part in PAGE.read_text("utf-8").split("\n## ")[1:]
)  # node: text


def program(node: str, number: int = 0) -> str:
    return str(re.findall(r"```python\n(.*?)```", SECTIONS[node], re.DOTALL)[number])


def start(graph: Any, node_class: Callable[..., Any], **settings: Any) -> Any:
    """The node of a section with what its command gives it, and settings that save time."""
    name = re.sub(r"(?<!^)(?=[A-Z])", "_", node_class.__name__.removesuffix("Node")).lower()
    command, *_ = re.findall(r"^ {4}(ros2 run infomap_ros .*)$", SECTIONS[name], re.MULTILINE)
    words = shlex.split(command)
    assert words[:4] == ["ros2", "run", "infomap_ros", name]
    given = words[4:] or None
    return graph.add(partial(node_class, cli_args=given), **settings)


@contextmanager
def running(
    graph: Any, node: str, folder: Path, number: int = 0
) -> Iterator[subprocess.Popen[str]]:
    """A program of a section as a process in the namespace of the graph."""
    (folder / "example.py").write_text(program(node, number), encoding="utf-8")
    command = [sys.executable, "example.py", "--ros-args", "-r", f"__ns:={graph.namespace}"]
    with subprocess.Popen(
        command, cwd=folder, env=graph.environment(), stdout=subprocess.PIPE, text=True
    ) as process:
        try:
            yield process
        finally:
            process.kill()


def said(graph: Any, process: subprocess.Popen[str], what: str) -> str:
    """The program's first line."""
    assert process.stdout is not None
    os.set_blocking(process.stdout.fileno(), False)
    lines: list[str] = []

    def read() -> bool:
        assert process.stdout is not None
        lines.extend(line for line in [process.stdout.readline()] if line)
        return bool(lines)

    graph.spin_until(read, what, 90.0)
    return lines[0].strip()


@pytest.mark.parametrize(
    "text",
    [p for part in SECTIONS.values() for p in re.findall(r"```python\n(.*?)```", part, re.S)],
)
def test_an_example_is_at_most_20_lines(text: str) -> None:
    assert len([line for line in text.splitlines() if line]) <= 20


class Base(PaperRover):
    """Has odometry, and is driven by cmd_vel."""

    is_located = False


def test_a_base_goes_along_a_path(graph: Any, tmp_path: Path) -> None:
    base = VelocityController(Base(graph), Twist)
    base.rover.obeys = False
    start(graph, RobotDriverNode)
    with running(graph, "robot_driver", tmp_path) as process:
        assert said(graph, process, "the result") == "done"
    assert abs(base.pose[0] - 0.5) < 0.1
    assert abs(base.pose[1]) < 0.05


def test_a_pair_of_cameras_is_located(graph: Any, tmp_path: Path) -> None:
    stage = BagStage(graph, IMAGES + INFOS)
    node = start(graph, FiducialLocalizationNode)
    stage.connect()
    topic = graph.tester.resolve_topic_name("camera_pose")
    with running(graph, "fiducial_localization", tmp_path) as process:
        listeners = graph.tester.count_subscribers
        graph.spin_until(lambda: listeners(topic) > 1, "the program", 90.0)
        located = [stage.located(stamp, node) for stamp in stage.play(3)]
        line = said(graph, process, "a pose")
    words = re.match(r"(\S+) (\S+) (\S+) m, sigma (\S+) m", line)
    assert words is not None
    assert None not in located
    place = np.array(words.groups()[:3], dtype=float)
    places = [pose.transform[:3, 3] for pose in located]
    assert min(np.abs(place - each).max() for each in places) <= 5.1e-4
    assert 0.0 < float(words[4]) < 0.1


def test_a_view_is_planned_on_a_map_that_is_told(graph: Any, tmp_path: Path) -> None:
    rover = PaperRover(graph, tells_updates=False)
    node = start(graph, NextBestViewNode, **QUICK)
    graph.connect(rover.updates, *rover.infos.values())
    for message in update_messages(rover.looks(-0.8, 0.0, 0.8)):
        rover.updates.publish(message)

    def is_ready() -> bool:
        try:
            node._ready()
        except InfomapError:
            return False
        return True

    graph.spin_until(is_ready, "robot and map")
    with running(graph, "next_best_view", tmp_path) as process:
        line = said(graph, process, "a view")
    words = re.match(r"look from (\S+) (\S+) (\S+) m", line)
    assert words is not None
    assert np.abs(np.array(words.groups(), dtype=float)).max() < 10.0


@pytest.mark.parametrize("write", [write_ot, write_bt])
def test_a_file_of_octomap_becomes_the_map(graph: Any, tmp_path: Path, write: Any) -> None:
    pytest.importorskip("octomap_msgs")
    seen = PaperRover(graph).looks(-0.8, 0.0, 0.8)
    write(seen, tmp_path / "hall.ot")
    node = graph.add(NextBestViewNode, **QUICK, map_source="octomap")
    with running(graph, "next_best_view", tmp_path, 1):
        graph.spin_until(lambda: node.health.results(), "the octree", 90.0)
    assert node._map.voxel_map().known_voxels == seen.known_voxels
