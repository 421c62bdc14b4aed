"""A map is put where it belongs: by teammates whose tags are seen, or by hand."""

from __future__ import annotations

import threading
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from geometry_msgs.msg import PoseWithCovarianceStamped
from sensor_msgs.msg import PointCloud2
from visualization_msgs.msg import MarkerArray

from infomap_ros.errors import UpdateRefusedError
from infomap_ros.geometry import (
    PinholeCamera,
    PoseRecord,
    invert_transform,
    perturb_transform,
    points_inside,
)
from infomap_ros.localization.localized_camera import LocalizedCamera
from infomap_ros.localization.target.tag_board import TagBoard, TagBoardConfig
from infomap_ros.localization.target.team_alignment import TeamTagsConfig, tag_pose
from infomap_ros.messages import decode_pose_with_covariance, encode_pose
from infomap_ros.messages.agents import encode_agent
from infomap_ros.messages.rows import encode_rows
from infomap_ros.nodes.common import qos
from infomap_ros.nodes.common.base import MonitoredNode
from infomap_ros.nodes.common.message_types import RclpyMessageTypes
from infomap_ros.nodes.locating.teammate_sight import TeammateSight
from infomap_ros.nodes.robot.robot_tracker import RobotTrackerConfig
from infomap_ros.nodes.team.map_moves import (
    alignment_message,
    encode_alignment,
    listen_to_moves,
    read_signed,
)
from infomap_ros.nodes.team.team_topics import TeamIdentityConfig
from infomap_ros.team.agent_board import agent_to_text
from infomap_ros.team.agents import Agent
from infomap_ros.team.membership import NOT_AUTHENTIC, TeamKey
from test.localization.tag_scenes import BoardView, pose_error, seen_from
from test.nodes.test_fiducial_localization import Stage

TYPES = RclpyMessageTypes()
SECOND = 1_000_000_000
TAG = tag_pose((-0.3, 0.0, 0.25), (-1.0, 0.0, 0.0))
PRINT = TagBoard(TagBoardConfig(columns=1, rows=1, side=0.16, first_id=5))
TAGS: dict[str, Any] = {
    "team_tags__robots": [1, 2],
    "team_tags__ids": [4, 5],
    "team_tags__poses": [*map(float, TAG), *map(float, TAG)],
}
T_THEIRS_MINE = perturb_transform(np.eye(4), [4.0, 1.0, 0.0, 0.0, 0.0, 0.7])


class SightNode(MonitoredNode):
    """A node that looks for teammates in the views that it is given."""

    CONFIGS = (
        (TeamTagsConfig, "team_tags."),
        (TeamIdentityConfig, ""),
        (RobotTrackerConfig, ""),
    )

    def __init__(self, *, stays: bool = False, **arguments: Any) -> None:
        super().__init__("sight", **arguments)
        self.moves: list[PoseRecord] = []
        self.origins: list[int] = []
        self.worker = self.start_worker(10)
        self.sight = TeammateSight(self, self.worker, self._note, stays=stays)

    def _note(self, move: PoseRecord, origin: int) -> None:
        self.moves.append(move)
        self.origins.append(origin)


class Meeting:
    """A robot that sees the tag on the back of robot 2 from some places."""

    def __init__(
        self, graph: Any, robot_id: int, rng: np.random.Generator, key_file: str = ""
    ) -> None:
        self.graph, self.rng, self.key = graph, rng, TeamKey.of_team(key_file)
        self.node = graph.add(SightNode, robot_id=robot_id, team_key=key_file, **TAGS)
        self.agents = graph.publisher(MarkerArray, "team/agents")
        kind, topic = PoseWithCovarianceStamped, "/rover2/map_alignment"
        if self.key is not None:
            kind, topic = PointCloud2, "/rover2/map_alignment_signed"
        self.told = graph.collect(kind, topic, qos.stream())
        graph.connect(self.agents)
        self.version = self.said = 0
        self.base = np.eye(4)

    def meet(self, stamp: int, T_theirs_mine: np.ndarray, origin: int = 0) -> None:
        """See the teammate, and then hear from it where it was."""
        T_camera_print = seen_from(PRINT, 1.1, 0.5, self.rng)
        view = BoardView(PRINT, T_camera_print, self.rng, range_sigma=0.004)
        view.stamp = stamp
        board = TagBoard(TagBoardConfig(side=0.16, ids=(5,), poses=tuple(map(float, TAG))))
        T_camera_base = T_camera_print @ PRINT.tag_poses[0] @ invert_transform(board.tag_poses[0])
        T_map_camera = perturb_transform(np.eye(4), self.rng.normal(0.0, 1.0, 6))
        result = LocalizedCamera(stamp, "tracking", T_map_camera, 1e-6 * np.eye(6))
        self.node.worker.submit_always(lambda: self.node.sight.look(view, result))
        base = self.base = T_theirs_mine @ T_map_camera @ T_camera_base
        for at in (stamp - SECOND // 10, stamp + SECOND // 10):
            self.version, self.said = self.version + 1, self.said + 1
            camera = PinholeCamera(64, 48, 45.0, 45.0, 31.5, 23.5)
            agent = Agent(
                2, 7, self.version, at, at, base, base, 1e-6 * np.eye(6), camera, 4.0, "looking",
                description="/rover2/robot_description", origin=origin,
            )  # fmt: skip
            text = agent_to_text(agent, self.key)
            message = encode_agent(TYPES, "map", agent, text, 2.0)
            self.agents.publish(message)
        seen = self.node.resolve_topic_name("team/agents")
        stream = self.node.health._streams[seen]
        self.graph.spin_until(lambda: stream.count >= self.said, "agents")


def check(found: np.ndarray, covariance: np.ndarray, truth: np.ndarray) -> None:
    error = pose_error(found, truth)
    assert np.linalg.norm(error[:3]) < 0.15
    assert error @ np.linalg.solve(covariance, error) < 27.9


def test_of_two_robots_the_one_with_the_larger_id_moves_its_map(
    graph: Any, rng: np.random.Generator
) -> None:
    meeting = Meeting(graph, 3, rng)
    for number in range(4):
        meeting.meet((10 + number) * SECOND, T_THEIRS_MINE)
    graph.spin_until(lambda: meeting.node.moves, "the move")
    (move,) = meeting.node.moves
    assert move.stamp == 13 * SECOND and move.covariance is not None
    check(move.transform, move.covariance, T_THEIRS_MINE)
    assert not meeting.told


@pytest.mark.parametrize("secret", ["", "sixteen bytes or more"])
def test_the_other_one_tells_its_teammate(
    graph: Any, rng: np.random.Generator, tmp_path: Path, secret: str
) -> None:
    (tmp_path / "key").write_text(secret)
    meeting = Meeting(graph, 1, rng, str(tmp_path / "key") if secret else "")
    for number in range(4):
        meeting.meet((10 + number) * SECOND, T_THEIRS_MINE)
    graph.spin_until(lambda: meeting.told, "the message")
    message, key = meeting.told[0], meeting.key
    assert message.header.frame_id == "map"
    move = decode_pose_with_covariance(message) if key is None else read_signed(message, key, 2)
    assert (move.frame_id, move.stamp) == ("map", 13 * SECOND)
    assert move.covariance is not None
    check(move.transform, move.covariance, invert_transform(T_THEIRS_MINE))
    assert not meeting.node.moves


def test_words_that_no_robot_can_say_next_are_not_believed(
    graph: Any, rng: np.random.Generator
) -> None:
    meeting = Meeting(graph, 3, rng)
    meeting.meet(10 * SECOND, T_THEIRS_MINE)
    meeting.version += 1 << 25
    meeting.meet(11 * SECOND, T_THEIRS_MINE)
    refused = {"version far ahead": 2}
    graph.spin_until(lambda: meeting.node.health.drops() == refused, "both words to be refused")


def test_maps_of_two_origins_are_joined_however_near_they_are(
    graph: Any, rng: np.random.Generator
) -> None:
    meeting, theirs = Meeting(graph, 1, rng), 1 << 16 | 5
    meeting.node.sight.origin = 3 << 16  # begun by robot 3, so that the smaller id moves
    assert meeting.node.sight.search == "looking"
    for number in range(3):
        meeting.meet((10 + number) * SECOND, np.eye(4), theirs)
    assert meeting.node.sight.bodies(12 * SECOND) == []  # nobody knows where that is
    graph.spin_until(lambda: meeting.node.sight.search == "seen", "the sighting")
    meeting.meet(13 * SECOND, np.eye(4), theirs)
    graph.spin_until(lambda: meeting.node.moves, "the move")
    assert meeting.node.origins == [theirs] and meeting.node.sight.other_origin() == theirs
    meeting.node.sight.origin = theirs
    assert meeting.node.sight.search == ""
    graph.spin_until(lambda: meeting.node.sight.bodies(13 * SECOND), "the teammate")


def test_robots_with_one_map_move_nothing(graph: Any, rng: np.random.Generator) -> None:
    meeting = Meeting(graph, 3, rng)
    for number in range(5):
        meeting.meet((10 + number) * SECOND, np.eye(4))
    graph.spin_until(lambda: "robot 2 seen at" in meeting.node.health.values(), "a sighting")
    assert not meeting.node.moves and not meeting.told


def alignment(stamp: int) -> PoseWithCovarianceStamped:
    pose = PoseRecord(stamp, "map", T_THEIRS_MINE, 1e-4 * np.eye(6))
    return encode_pose(TYPES, pose)


def signed(key: TeamKey, robot: int = 2, stamp: int = SECOND) -> PointCloud2:
    pose = PoseRecord(stamp, "map", T_THEIRS_MINE, 1e-4 * np.eye(6))
    return alignment_message(TYPES, pose, robot, key)


def changed(message: PointCloud2) -> PointCloud2:
    message.data[8] ^= 1
    return message


def in_other_frame(message: PointCloud2) -> PointCloud2:
    for field in message.fields:
        field.name = field.name.replace("frame=map", "frame=world")
    return message


def test_only_the_team_moves_a_map_that_has_a_key() -> None:
    ours, others = TeamKey(b"secret of this team"), TeamKey(b"secret of another one")
    for message in (
        signed(others),
        signed(ours, robot=3),
        changed(signed(ours)),
        in_other_frame(signed(ours)),
        signed(ours, stamp=0),  # good at any time
        encode_rows(TYPES, SECOND, "map", encode_alignment(read_signed(signed(ours), ours, 2), 2)),
    ):
        with pytest.raises(UpdateRefusedError) as error:
            read_signed(message, ours, 2)
        assert error.value.reason == NOT_AUTHENTIC
    message = signed(ours)
    assert message.header.frame_id == "map"
    opened = read_signed(message, ours, 2)
    assert (opened.frame_id, opened.stamp) == ("map", SECOND)
    np.testing.assert_array_equal(opened.transform, T_THEIRS_MINE)
    np.testing.assert_array_equal(opened.covariance, 1e-4 * np.eye(6))


class MovedNode(MonitoredNode):
    """A node whose map is moved by the team."""

    def __init__(self, key: TeamKey | None, **arguments: Any) -> None:
        super().__init__("moved", **arguments)
        self.moves: list[PoseRecord] = []
        self.may_move = threading.Event()
        self.may_move.set()
        listen_to_moves(self, "map", self.start_worker(10), self._move, key=key, robot=2)

    def _move(self, pose: PoseRecord) -> None:
        self.may_move.wait(60.0)
        self.moves.append(pose)


def test_with_a_key_only_what_is_signed_is_heard(graph: Any) -> None:
    key = TeamKey(b"secret of this team")
    node = graph.add(partial(MovedNode, key))
    plain = graph.publisher(PoseWithCovarianceStamped, "map_alignment")
    secret = graph.publisher(PointCloud2, "map_alignment_signed")
    graph.connect(plain, secret)
    plain.publish(alignment(SECOND))
    graph.spin_until(lambda: node.health.drops() == {NOT_AUTHENTIC: 1}, "the refusal")
    secret.publish(signed(key))
    graph.spin_until(lambda: node.moves, "the move")
    assert node.moves[0].frame_id == "map" and len(node.moves) == 1


def test_of_a_flood_of_moves_a_few_wait_the_newest(graph: Any) -> None:
    node = graph.add(partial(MovedNode, None))
    publisher = graph.publisher(PoseWithCovarianceStamped, "map_alignment")
    graph.connect(publisher)
    node.may_move.clear()
    for number in range(1, 61):
        publisher.publish(alignment(number * SECOND))
        graph.spin_until(partial(has_come, node, number), "the move to be heard")
    node.may_move.set()
    graph.spin_until(lambda: node.moves and node.moves[-1].stamp == 60 * SECOND, "the newest")
    assert len(node.moves) <= 17
    assert sum(node.health.drops().values()) == 60 - len(node.moves)


def has_come(node: MovedNode, number: int) -> bool:
    return int(node.health.values()[f"{node.get_namespace()}/map_alignment count"]) >= number


def aligned(stage: Stage, stamp: int = 0) -> None:
    topic = "map_alignment"
    publisher = stage.graph.publisher(PoseWithCovarianceStamped, topic)
    stage.graph.connect(publisher)
    publisher.publish(alignment(stamp))


def test_a_map_is_moved_by_hand_and_the_camera_goes_on_in_it(graph: Any) -> None:
    stage = Stage(graph, follow_alignment=True)
    before = stage.run(4)
    aligned(stage)
    graph.spin_until(lambda: "last move" in stage.node.health.values(), "the move")
    after = stage.run(2, first=5)
    assert len(after) == 2
    for stamp in before:  # as they would be in the map where it is now
        pose = stage.poses[stamp]
        moved = PoseRecord(stamp, "map", T_THEIRS_MINE @ pose.transform, pose.covariance)
        stage.poses[stamp] = moved
    assert stage.errors(before + after).max() < 0.02
    told = stage.poses[after[0]].covariance
    assert told is not None and told[:3, :3].trace() > 2e-4  # the move's error is in it
    aligned(stage, stamp=before[0])
    graph.spin_until(lambda: "invalid data" in stage.node.health.drops(), "the refusal")


def test_a_map_is_not_moved_by_anybody_unless_it_is_allowed(graph: Any) -> None:
    stage = Stage(graph)
    topic = stage.graph.tester.resolve_topic_name("map_alignment")
    assert stage.graph.tester.count_subscribers(topic) == 0


def test_tags_of_the_own_robot_are_not_looked_for(graph: Any) -> None:
    node = graph.add(SightNode, robot_id=1, team_tags__robots=[1], team_tags__ids=[4],
                     team_tags__poses=[float(number) for number in TAG])  # fmt: skip
    assert node.sight._finder is None


def test_it_is_known_where_a_teammate_is_that_is_heard(
    graph: Any, rng: np.random.Generator
) -> None:
    meeting = Meeting(graph, 3, rng)
    assert meeting.node.sight.bodies(10 * SECOND) == []
    meeting.meet(10 * SECOND, T_THEIRS_MINE)
    graph.spin_until(lambda: meeting.node.sight.bodies(10 * SECOND), "the teammate to be heard")
    (body,) = meeting.node.sight.bodies(10 * SECOND)
    assert points_inside(meeting.base[None, :3, 3], [body]).all()
    (grown,) = meeting.node.sight.bodies(12 * SECOND)
    beside = meeting.base[None, :3, 3] + (body.solid.radius + 0.15) * meeting.base[:3, 0]
    assert points_inside(beside, [grown]).all() and not points_inside(beside, [body]).any()


def test_a_robot_that_works_alone_hears_of_nobody(graph: Any) -> None:
    """What other nodes of it tell on team/agents is not taken for a teammate."""
    node = graph.add(SightNode, robot_id=0)
    assert node.resolve_topic_name("team/agents") not in node.health._streams
    assert node.sight.bodies(10 * SECOND) == []
