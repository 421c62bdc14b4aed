"""team/agents over DDS: what a robot tells of itself, who is refused, and who is cut from scans."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from std_msgs.msg import String
from visualization_msgs.msg import MarkerArray

from infomap_ros.geometry import PinholeCamera, TextRecord, make_transform
from infomap_ros.messages import encode_text
from infomap_ros.messages.agents import decode_agent_texts, encode_agent
from infomap_ros.motion.robot.urdf import hash_of_description
from infomap_ros.nodes.common import qos
from infomap_ros.team import agent_board
from infomap_ros.team.agent_board import agent_from_text, agent_to_text
from infomap_ros.team.agents import Agent
from infomap_ros.team.membership import NOT_AUTHENTIC, NOT_LISTED, TeamKey

from .test_map_fusion import SECOND, START, TYPES, Bench, as_replica, cloud, expected_map, pose
from .test_next_best_view import Stage, status

CAMERA = PinholeCamera(64, 48, 45.0, 45.0, 31.5, 23.5)
SECRET = b"a secret that only the team has"
BOX = (
    '<robot name="box"><link name="base_link"><collision><geometry><box size="0.6 0.6 0.6"/>'
    "</geometry></collision></link></robot>"
)


def mate(robot: int = 2, version: int = 1, stamp: int = START, **fields: Any) -> Agent:
    base = make_transform(np.eye(3), fields.pop("place", (2.3, 0.0, 1.0)))
    given: dict[str, Any] = {
        "radius": 0.43, "bottom": -0.3, "top": 0.3, "base_frame": "base_link",
    }  # fmt: skip
    covariance = 1e-8 * np.eye(6)
    numbers = robot, 1, version, stamp, stamp
    return Agent(*numbers, base, base, covariance, CAMERA, 4.0, **(given | fields))


def message(agent: Agent, key: TeamKey | None = None, frame: str = "map") -> Any:
    return encode_agent(TYPES, frame, agent, agent_to_text(agent, key), 5.0)


def told(messages: list[Any], key: TeamKey | None = None) -> list[Agent]:
    return [agent_from_text(text, key) for m in messages for _, text in decode_agent_texts(m)]


def test_a_robot_tells_where_it_is_and_what_it_is_heading_for(graph: Any) -> None:
    said = graph.collect(MarkerArray, "team/agents")
    stage = Stage(graph, robot_id=6)
    stage.tell(stage.rover.updates, -0.8, 0.0, 0.8)
    stage.status.publish(status())
    graph.spin_until(
        lambda: said and np.allclose(told(said)[-1].T_map_base, stage.rover.base), "where it is"
    )
    here = told(said)[-1]
    assert (here.robot, here.goal, here.max_range) == (6, None, 4.0)
    np.testing.assert_allclose(here.T_map_camera, stage.rover.T_map_camera(), atol=1e-9)
    np.testing.assert_allclose(here.T_map_base, stage.rover.base, atol=1e-9)
    assert dict(here.joints) == pytest.approx(stage.rover.joints)
    assert here.description == graph.tester.resolve_topic_name("robot_description")
    assert here.stamp % 50_000_000 == 0 and here.covariance is not None

    choice = stage.plan()
    assert choice.pose is not None
    graph.spin_until(lambda: told(said)[-1].goal is not None, "the goal")
    claimed = told(said)[-1]
    np.testing.assert_allclose(claimed.goal, choice.pose, atol=1e-6)
    assert claimed.claim > here.claim
    stage.status.publish(DiagnosticStatus(**{**as_fields(status()), "message": "ended: done"}))
    graph.spin_until(lambda: told(said)[-1].goal is None, "the goal given up")
    assert told(said)[-1].state == "ended: done"


def as_fields(message: DiagnosticStatus) -> dict[str, Any]:
    return {name: getattr(message, name) for name in message.get_fields_and_field_types()}


def test_a_plan_leaves_to_a_teammate_what_it_heads_for(graph: Any) -> None:
    stage = Stage(graph)
    agents = graph.publisher(MarkerArray, "team/agents")
    graph.connect(agents)
    stage.tell(stage.rover.updates, -0.8, 0.0, 0.8)
    alone = stage.plan()
    assert alone.pose is not None
    goal = mate(place=(9.0, 9.0, 0.0), goal=alone.pose, claim=1)
    agents.publish(message(goal))
    health = stage.node.health
    graph.spin_until(lambda: health.values().get("teammates") == "2", "the teammate")
    agents.publish(message(replace(goal, version=2)))
    choice = stage.plan()
    assert choice.pose is None or np.linalg.norm(choice.pose[:3, 3] - alone.pose[:3, 3]) > 0.5
    assert any("teammate" in reason for reason in choice.explanation["rejections"])


def test_strangers_and_nonsense_are_refused_and_counted(graph: Any, tmp_path: Path) -> None:
    (tmp_path / "key").write_bytes(SECRET)
    stage = Stage(graph, team=[0, 2], team_key=str(tmp_path / "key"))
    agents, key = graph.publisher(MarkerArray, "team/agents"), TeamKey(SECRET)
    graph.connect(agents)
    agents.publish(message(mate()))
    stage.wait_for_drops(NOT_AUTHENTIC, 1)
    agents.publish(message(mate(9), key))
    stage.wait_for_drops(NOT_LISTED, 1)
    agents.publish(message(mate(), key, frame="odom"))
    stage.wait_for_drops("wrong frame", 1)
    broken = message(mate(), key)
    content = '{"infomap_agent":1}'
    broken.markers[0].text = f"{content}\n{key.code_of_text(content)}"
    agents.publish(broken)
    stage.wait_for_drops("invalid data", 1)
    assert stage.node._agents.team.present(0.0) == ()
    agents.publish(message(mate(), key))
    health = stage.node.health
    graph.spin_until(lambda: health.values().get("teammates") == "2", "the teammate")


class Wall:
    """map_fusion before a wall at 2 m, in which the front of a teammate, a box, hides."""

    def __init__(self, graph: Any, **parameters: Any) -> None:
        self.bench = Bench(graph, **{"robot_id": 1, "team": [2], **parameters})
        self.agents = graph.publisher(MarkerArray, "team/agents")
        topic = graph.tester.resolve_topic_name("mate/robot_description")
        self.description = graph.tester.create_publisher(String, topic, qos.latched())
        self.description.publish(encode_text(TYPES, TextRecord(0, "", BOX)))
        self.topic, self.graph = topic, graph
        graph.connect(self.agents)

    def tell(self, milliseconds: int, version: int, **fields: Any) -> None:
        stamp = START + milliseconds * 1_000_000
        given = {"description": self.topic, "description_hash": hash_of_description(BOX)} | fields
        self.agents.publish(message(mate(2, version, stamp, **given)))

    def wait_until_described(self) -> None:
        bodies = self.bench.node._inputs._teammates._bodies
        self.graph.spin_until(lambda: bodies.is_described(2), "the description")

    def in_box(self) -> list[Any]:
        """Occupied voxels of the wall that belong to the box's front, and the others'."""
        low, high = np.array([1.9, -0.29, 0.71]), np.array([2.2, 0.29, 1.29])
        known = as_replica(self.bench.node._keeper._map)
        occupied = [index for index, (odds, _) in known.items() if odds > 0]
        centers = (np.array(occupied).reshape(-1, 3) + 0.5) * 0.1
        inside = ((centers > low) & (centers < high)).all(axis=1)
        return [int(inside.sum()), int((~inside).sum())]


def test_a_teammate_is_cut_from_a_scan_that_waits_for_its_place(graph: Any) -> None:
    wall = Wall(graph)
    wall.tell(-100, 1)
    wall.wait_until_described()
    wall.bench.send(pose(), cloud())
    health, topic = wall.bench.node.health, graph.tester.resolve_topic_name("points2")
    graph.spin_until(lambda: health.values()[f"{topic} count"] == "1", "the cloud")
    wall.bench.send(pose(START + 1000))
    for _ in range(20):
        graph.executor.spin_once(timeout_sec=0.01)
    assert health.results() == 0, "it waits"
    wall.tell(100, 2)
    wall.bench.wait_for_results(1)
    inside, others = wall.in_box()
    assert inside == 0
    whole = expected_map(cloud())
    assert others > 0.75 * len(whole.gaussians()[0])


def test_who_was_mapped_before_it_was_heard_is_taken_out_when_it_is(graph: Any) -> None:
    wall = Wall(graph)
    wall.bench.send(pose(), cloud())
    wall.bench.wait_for_results(1)
    image, others = wall.in_box()
    assert image > 20
    wall.tell(0, 1)
    wall.wait_until_described()
    wall.tell(200, 2)
    graph.spin_until(lambda: wall.in_box()[0] == 0, "the teammate to be taken out")
    assert wall.in_box()[1] > 0.75 * others
    wall.bench.wait_for_map(as_replica(wall.bench.node._keeper._map))


def test_the_wait_ends_and_a_larger_body_is_cut(graph: Any) -> None:
    wall = Wall(graph)
    wall.tell(-100, 1)
    wall.wait_until_described()
    wall.bench.send(pose(), cloud(), pose(START + SECOND))
    wall.bench.wait_for_results(1)
    inside, others = wall.in_box()
    assert inside == 0 and others > 50
    assert "2 (place not sure)" in wall.bench.node.health.values()["teammates in scans"]


def test_who_was_forgotten_and_is_back_is_still_what_it_was(
    graph: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(agent_board, "_MEMORY", 0.1)
    wall = Wall(graph)
    wall.tell(-100, 1)
    wall.wait_until_described()
    inputs = wall.bench.node._inputs
    graph.spin_until(
        lambda: not inputs._teammates.bodies_in(pose()),
        "the teammate to be forgotten",
    )
    wall.tell(0, 2)
    wall.wait_until_described()


def test_a_description_that_a_teammate_has_not_told_is_not_read(graph: Any) -> None:
    wall = Wall(graph)
    wall.tell(-100, 1, description_hash="0" * 64)
    health = wall.bench.node.health
    graph.spin_until(lambda: health.values().get(f"dropped: {NOT_AUTHENTIC}"), "the refusal")
    assert not wall.bench.node._inputs._teammates._bodies.is_described(2)
    wall.tell(0, 2)
    wall.wait_until_described()


def test_descriptions_of_strangers_are_not_listened_to(graph: Any) -> None:
    wall = Wall(graph, team=[])
    wall.tell(-100, 1)
    teammates = wall.bench.node._inputs._teammates
    graph.spin_until(lambda: teammates._board.remembered(0.0), "the stranger")
    assert graph.tester.count_subscribers(wall.topic) == 0
