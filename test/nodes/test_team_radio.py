"""Losses on purpose, and what robots say of the map that they share."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from sensor_msgs.msg import PointCloud2
from std_srvs.srv import Trigger

from infomap_ros.mapping import VoxelMap, VoxelMapConfig
from infomap_ros.messages.rows import decode_rows, encode_rows
from infomap_ros.nodes.common.message_types import RclpyMessageTypes
from infomap_ros.nodes.map_fusion import MapFusionNode
from infomap_ros.nodes.team.team_radio import TeamRadioConfig, loses
from infomap_ros.team.digest import CellDigest
from infomap_ros.team.replica import MapReplica
from infomap_ros.team.wire import decode_update

from .rovers import update_messages


def messages(robot: int) -> list[PointCloud2]:
    """What a robot tells that saw a wall."""
    seen = VoxelMap(VoxelMapConfig(voxel_size=0.1))
    seen.track_changes(True)
    wall = np.random.default_rng(robot).uniform((1.0, -0.5, 0.0), (1.05, 0.5, 1.0), (200, 3))
    seen.integrate(wall, np.eye(4))
    return update_messages(seen, robot)


def ask(graph: Any, service: str = "team_hash") -> Any:
    client = graph.tester.create_client(Trigger, f"map_fusion/{service}")
    graph.spin_until(client.service_is_ready, "the service")
    answer = client.call_async(Trigger.Request())
    graph.spin_until(answer.done, "the answer")
    return answer.result()


def test_a_robot_tells_the_hash_of_what_it_has_heard(
    graph: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("time.time_ns", lambda: 0)  # versions of the made-up robots begin at 1
    graph.add(MapFusionNode, voxel_size=0.1, robot_id=1)
    assert not ask(graph).success  # alone
    team = graph.publisher(PointCloud2, "team/map_updates")
    graph.connect(team)
    replica = MapReplica(VoxelMapConfig(voxel_size=0.1))
    for robot in (7, 9):
        for message in messages(robot):
            team.publish(message)
            replica.apply(decode_update(decode_rows(message)[2]))

    def account() -> dict[str, Any]:
        answer = ask(graph)
        return json.loads(answer.message) if answer.success else {}

    graph.spin_until(lambda: account().get("robots") == [7, 9], "both robots")
    assert account()["hash"] == f"{replica.hash():016x}"
    known = replica.voxel_map.known_voxels  # the sum over robots is made from time to time
    graph.spin_until(lambda: account().get("known_voxels") == known, "the map of both")


def test_the_map_of_the_team_is_saved(
    graph: Any, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr("time.time_ns", lambda: 0)
    own = tmp_path / "map.infomap"
    graph.add(MapFusionNode, voxel_size=0.1, robot_id=1, map_file=str(own))
    assert "no other robot" in ask(graph, "save_team").message
    team = graph.publisher(PointCloud2, "team/map_updates")
    graph.connect(team)
    replica = MapReplica(VoxelMapConfig(voxel_size=0.1))
    for robot in (7, 9):
        for message in messages(robot):
            team.publish(message)
            replica.apply(decode_update(decode_rows(message)[2]))
    shared = replica.voxel_map
    known = f"saved {shared.known_voxels} voxels"
    graph.spin_until(lambda: known in ask(graph, "save_team").message, "the map of both")

    saved = VoxelMap.load(tmp_path / "map_team.infomap")
    for found, expected in zip(saved.gaussians(), shared.gaussians(), strict=True):
        np.testing.assert_array_equal(found, expected)
    np.testing.assert_array_equal(saved.voxels()[0], shared.voxels()[0])
    assert ask(graph, "save").success  # what this robot saw, in its own file
    assert VoxelMap.load(own).known_voxels == 0


def test_a_digest_with_a_repeated_block_is_one_bad_message(graph: Any) -> None:
    node = graph.add(MapFusionNode, voxel_size=0.1, robot_id=1)
    digests = graph.publisher(PointCloud2, "team/digests")
    graph.connect(digests)
    corners = np.array([[0, 0, 0], [1, 0, 0], [0, 0, 0]], np.int32)
    cells = CellDigest(7, 1, 1, 100, 5, 0, corners, np.array([1, 2, 3], np.uint32))
    digests.publish(encode_rows(RclpyMessageTypes(), 0, "map", cells.encode(1400)[0]))

    graph.spin_until(lambda: node.health.drops() == {"invalid data": 1}, "the drop")
    assert ask(graph).message == "team: no other robot has reported"  # still serves


def test_messages_of_the_team_get_lost_and_no_others() -> None:
    radio = TeamRadioConfig(simulated_loss=0.2)
    lost = sum(loses(radio, "team/digests") for _ in range(5000))
    assert 800 < lost < 1200  # seven standard deviations about 1000
    assert not any(loses(radio, "map_updates") for _ in range(100))
    assert not any(loses(TeamRadioConfig(), "team/digests") for _ in range(100))


def test_what_gets_lost_is_counted(graph: Any) -> None:
    node = graph.add(MapFusionNode, voxel_size=0.1, robot_id=1, team_map__simulated_loss=0.99)
    team = graph.publisher(PointCloud2, "team/map_updates")
    graph.connect(team)
    for _ in range(10):
        team.publish(messages(7)[0])
    graph.spin_until(lambda: node.health.drops().get("simulated loss", 0) >= 8, "losses")
