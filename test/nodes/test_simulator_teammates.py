"""Two simulator nodes, one world: each sees the other where it is, at the same time."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from nav_msgs.msg import Path

from infomap_ros.errors import ConfigError
from infomap_ros.messages.motions import encode_base_path
from infomap_ros.nodes import simulator
from infomap_ros.nodes.common.message_types import RclpyMessageTypes
from infomap_ros.nodes.simulator import SimulatorNode
from infomap_ros.simulation.turns import SharedTime

SMALL = {
    "world": "office",
    "camera__width": 64,
    "camera__height": 48,
    "images_while_moving": False,
    "publish_tf": False,
    "pace": 0.0,
}


def test_two_robots_in_one_world(graph: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(simulator, "_SILENCE", 2.0)
    base, names = graph.namespace, ("one", "two")
    nodes = {}
    for name, mate, y in ((*names, 0.5), (*reversed(names), -0.5)):
        graph.namespace = f"{base}/{name}"
        others = {"teammates": [f"{base}/{mate}"], "publish_clock": name == "one"}
        nodes[name] = graph.add(SimulatorNode, start=[-1.75, y, 0.0], **SMALL, **others)
    one, two = (nodes[name]._simulator for name in names)
    copy = two._body.data.body(f"{base}/one/base_link"[1:])
    graph.spin_until(lambda: copy.xpos[2] > -1.0, "one to be seen by two")
    graph.spin_until(lambda: abs(one.time - two.time) < 0.5, "one time of both")

    drive = graph.publisher(Path, f"{base}/one/base_path")
    graph.connect(drive)
    path = np.array([(0.0, 0.0, 0.0), (0.4, 0.0, 0.0)])
    drive.publish(encode_base_path(RclpyMessageTypes(), 0, "odom", path))
    apart: list[float] = []

    def arrived() -> bool:
        apart.append(abs(one.time - two.time))
        return bool(copy.xpos[0] > -1.45 and not one.is_moving)

    graph.spin_until(arrived, "one to drive away")
    graph.spin_until(lambda: np.allclose(copy.xpos, one.true_pose()[:3, 3], atol=1e-3), "its end")
    assert max(apart) < 0.5  # window, and what passed between the two readings

    left = one.time
    graph.executor.remove_node(nodes["one"])
    nodes["one"].destroy_node()
    graph.nodes.remove(nodes["one"])
    graph.spin_until(lambda: two.time > left + 0.5, "two to go on alone")
    np.testing.assert_allclose(copy.xpos, one.true_pose()[:3, 3], atol=1e-3)  # and it stands there


def test_nobody_runs_ahead_and_who_was_away_skips() -> None:
    shared = SharedTime(window=0.1, silence=5.0)
    assert shared.may_step(100.0, now=0.0)
    shared.receive("other", 10.0, now=0.0)
    assert shared.may_step(10.05, now=1.0)
    assert not shared.may_step(10.11, now=1.0)
    assert shared.may_step(10.11, now=5.5)
    assert shared.missed(9.9, now=1.0) == 0.0
    assert shared.missed(7.0, now=1.0) == pytest.approx(3.0)
    assert shared.missed(7.0, now=5.5) == 0.0


def test_one_namespace_twice_is_refused(graph: Any) -> None:
    with pytest.raises(ConfigError, match="teammates"):
        graph.add(SimulatorNode, teammates=["/one", "one/"], **SMALL)
