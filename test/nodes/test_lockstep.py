"""A short exploration by the nodes in lockstep, and in one process: the same choices and map."""

from __future__ import annotations

import json
import threading
import time
from pathlib import Path
from typing import Any, ClassVar

import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from rosgraph_msgs.msg import Clock
from std_msgs.msg import String
from std_srvs.srv import Trigger

from infomap_ros.cli.command_options import with_settings
from infomap_ros.exploration.mission import Mission
from infomap_ros.mapping import VoxelMap
from infomap_ros.nodes.common import qos
from infomap_ros.nodes.common.base import MonitoredNode
from infomap_ros.nodes.common.lockstep import (
    REPORTS,
    TIME,
    LockstepConductor,
    LockstepConfig,
)
from infomap_ros.nodes.explorer import ExplorerNode
from infomap_ros.nodes.fiducial_localization import FiducialLocalizationNode
from infomap_ros.nodes.live.live_exploration import robot_parameters
from infomap_ros.nodes.map_fusion import MapFusionNode
from infomap_ros.nodes.next_best_view import NextBestViewNode
from infomap_ros.nodes.simulator import SimulatorNode
from infomap_ros.nodes.stereo_range import StereoRangeNode
from infomap_ros.simulation.cameras.stereo_camera import DRAWN_FAST
from infomap_ros.simulation.exploring.exploration_run import (
    ExplorationOptions,
    ExplorationRun,
    task_in,
)
from test.pipeline.map_hash import map_hash

NODES = {
    "fiducial_localization": FiducialLocalizationNode,
    "stereo_range": StereoRangeNode,
    "map_fusion": MapFusionNode,
    "next_best_view": NextBestViewNode,
    "explorer": ExplorerNode,
}
RESUMES = ("simulator", "fiducial_localization", "map_fusion", "explorer")
CAMERA = {
    f"camera.{name}": value for name, value in {"width": 320, "height": 240, **DRAWN_FAST}.items()
}
PLANNER = {"arm_views": 50, "choice.candidates.candidates": 200, "threads": 1}
VIEWS, RANGE = 2, 3.0


def in_process(out: Path) -> tuple[list[dict[str, Any]], str, ExplorationRun]:
    """The exploration in this process."""
    settings = ["world.name=mars", "world.seed=2", "world.size=4.5", f"task.max_views={VIEWS}"]
    settings += [f"simulator.{name}={value}" for name, value in CAMERA.items()]
    settings += [f"planner.{name}={value}" for name, value in PLANNER.items()]
    settings += [f"planner.max_range={RANGE}", "map.threads=1"]
    run = ExplorationRun(with_settings(ExplorationOptions(), settings), out)
    run.run()
    run.close()
    return entries(out), map_hash(run.map), run


def by_nodes(out: Path, graph: Any, run: ExplorationRun) -> tuple[list[dict[str, Any]], str]:
    """The same by nodes in lockstep."""
    task = task_in(run.simulator.world, run.options.task, run.T_world_map)
    area: dict[str, object] = {
        "task.region_low": task.region_low,
        "task.region_high": task.region_high,
    }
    area |= {"task.max_views": VIEWS}
    own: dict[str, dict[str, object]] = {
        "simulator": {"world": "mars", "world_seed": 2, "world_size": 4.5, "seed": 2, **CAMERA}
        | {"state_file": ""},
        "fiducial_localization": {"state_file": ""},
        "map_fusion": {"max_range": RANGE, "map_file": str(out / "map.infomap"), "threads": 1}
        | {"waiting.max_wait": 1.0, "autosave_period": 0.0},
        "next_best_view": {**area, **PLANNER, "max_range": RANGE},
        "explorer": area,
    }
    parameters = robot_parameters(out, graph.namespace + "/", lockstep=True)
    for name, node in {"simulator": SimulatorNode, **NODES}.items():
        values = parameters[name] | own.get(name, {}) | {"resume": False}
        known = {key: value for key, value in values.items() if key != "resume" or name in RESUMES}
        graph.add(node, **{key: native(value) for key, value in known.items()})
    log = out / "exploration.jsonl"
    graph.spin_until(
        lambda: log.is_file() and '"end"' in log.read_text(), "the exploration to end", 600.0
    )
    client = graph.tester.create_client(Trigger, "map_fusion/save")
    graph.spin_until(client.service_is_ready, "save")
    answer = client.call_async(Trigger.Request())
    graph.spin_until(answer.done, "the file")
    return entries(out), map_hash(VoxelMap.load(out / "map.infomap"))


def entries(out: Path) -> list[dict[str, Any]]:
    """What the run log says of choices, motions and the map, but for how long it took."""
    lines = (out / "exploration.jsonl").read_text().splitlines()
    told = [json.loads(line) for line in lines[1:]]
    return [
        {k: v for k, v in entry.items() if k not in ("t", "clock", "seconds")} for entry in told
    ]


def native(value: object) -> object:
    """A value as a parameter of ROS."""
    if isinstance(value, Path):
        return str(value)
    return list(value) if isinstance(value, tuple) else value


def test_the_nodes_choose_and_map_as_the_exploration_in_one_process(
    graph: Any, tmp_path: Path
) -> None:
    for name in ("one", "nodes"):
        (tmp_path / name).mkdir()
    first, first_map, run = in_process(tmp_path / "one")
    second, second_map = by_nodes(tmp_path / "nodes", graph, run)

    assert sum(entry["kind"] == "decision" for entry in first) == VIEWS
    assert second == first
    assert second_map == first_map
    seconds = Mission.load(tmp_path / "nodes" / "mission.json").seconds
    assert seconds == pytest.approx(run.simulator.time, abs=2.0), "the robot's, not the machine's"


class Listener(MonitoredNode):
    """Takes part, and keeps what it is sent."""

    CONFIGS: ClassVar = ((LockstepConfig, ""),)

    def __init__(self, **node_arguments: Any) -> None:
        super().__init__("listener", **node_arguments)
        self.texts: list[str] = []
        self.listen(String, "news", self._on_news, qos.latched())

    def _on_news(self, message: String) -> None:
        self.texts.append(message.data)


class Speaker(MonitoredNode):
    """Has time wait for the listener."""

    CONFIGS: ClassVar = ((LockstepConfig, ""),)

    def __init__(self, **node_arguments: Any) -> None:
        super().__init__("speaker", **node_arguments)
        self.publisher = self.advertise(String, "news", qos.latched())
        assert self.lockstep is not None
        self.conductor = LockstepConductor(self, self.lockstep, ["listener"], lambda: False)


def in_thread(graph: Any, action: Any) -> None:
    """Serve the graph while an action waits."""
    thread = threading.Thread(target=action, daemon=True)
    thread.start()
    graph.spin_until(lambda: not thread.is_alive(), "the action")


def test_no_moment_begins_before_all_that_was_sent_in_the_last_one_is_used(graph: Any) -> None:
    listener = graph.add(Listener, lockstep=True)
    speaker = graph.add(Speaker, lockstep=True)
    moments = graph.collect(Clock, TIME)
    in_thread(graph, speaker.conductor.begin)

    wanted = [str(number) for number in range(20)]
    for text in wanted:  # more than the queue of a latched topic would keep
        speaker.publisher.publish(String(data=text))
    thread = threading.Thread(target=speaker.conductor.settle, args=(1,), daemon=True)
    thread.start()
    time.sleep(0.3)  # nobody is served: a moment that began now would be on its way
    assert thread.is_alive()
    used_at_the_moment: list[int] = []

    def has_begun() -> bool:
        if moments and not used_at_the_moment:
            used_at_the_moment.append(len(listener.texts))
        return not thread.is_alive()

    graph.spin_until(has_begun, "the moment")
    assert listener.texts == wanted
    assert used_at_the_moment == [len(wanted)]


def test_what_is_latched_has_been_used_when_time_begins(graph: Any) -> None:
    speaker = graph.add(Speaker, lockstep=True)
    for text in ("one", "two"):
        speaker.publisher.publish(String(data=text))
    listener = graph.add(Listener, lockstep=True)
    in_thread(graph, speaker.conductor.begin)
    assert listener.texts == ["one", "two"]


def test_time_begins_also_where_a_node_has_reported_before_the_simulator_came(graph: Any) -> None:
    graph.add(Listener, lockstep=True)
    reports = graph.collect(DiagnosticStatus, REPORTS)
    graph.spin_until(lambda: len(reports) > 1, "the listener to report, and again")
    speaker = graph.add(Speaker, lockstep=True)
    in_thread(graph, speaker.conductor.begin)
