"""bag_player over DDS: what is in the bag comes out, unchanged and in order, with /clock."""

from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from geometry_msgs.msg import PoseWithCovarianceStamped
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import Image, JointState, PointCloud2
from std_msgs.msg import String

from infomap_ros.errors import BagError, ConfigError
from infomap_ros.geometry import (
    ImageRecord,
    JointStateRecord,
    PointCloudRecord,
    PoseRecord,
    TextRecord,
    TransformRecord,
)
from infomap_ros.messages import decode_image, decode_joint_state, encode_point_cloud
from infomap_ros.nodes.bag_player import BagPlayerNode
from infomap_ros.nodes.common import qos
from infomap_ros.nodes.common.message_types import RclpyMessageTypes
from infomap_ros.replay.bags import player as player_module
from infomap_ros.replay.bags.writer import BagWriter

SECOND = 1_000_000_000
START = 1_700_000_000 * SECOND
STEP = SECOND // 10
COUNT = 6


@pytest.fixture
def bag(tmp_path: Path) -> Path:
    """Images, poses and joint states at 10 Hz, a robot description and a static transform."""
    rng = np.random.default_rng(3)
    with BagWriter(tmp_path / "bag") as writer:
        writer.write("/robot_description", TextRecord(START, "", "<robot/>"))
        static = TransformRecord(START, "base", "camera", np.eye(4), is_static=True)
        writer.write("/tf_static", static)
        for index in range(COUNT):
            stamp = START + index * STEP
            pixels = rng.integers(0, 256, (40, 60), dtype=np.uint8)
            writer.write("/left/image_raw", ImageRecord(stamp, "camera", pixels, "mono8"))
            writer.write("/camera_pose", PoseRecord(stamp, "map", np.eye(4), np.eye(6)))
            joints = JointStateRecord(stamp, "", ("arm",), np.array([0.1 * index]))
            writer.write("/joint_states", joints)
    return tmp_path / "bag"


def stamp_of(message: Any) -> int:
    stamp = message.clock if isinstance(message, Clock) else message.header.stamp
    return stamp.sec * SECOND + stamp.nanosec


STAMPS = [START + index * STEP for index in range(COUNT)]


def test_messages_come_out_as_they_are_in_the_bag(graph: Any, bag: Path) -> None:
    images = graph.collect(Image, "left/image_raw")
    poses = graph.collect(PoseWithCovarianceStamped, "camera_pose")
    joints = graph.collect(JointState, "joint_states")
    names = ["left/image_raw", "camera_pose", "joint_states"]
    player = graph.add(BagPlayerNode, bag=str(bag), rate=20.0, wait_for_subscribers=names)

    graph.spin_until(player.finished.done, "the end of the bag")
    graph.spin_until(lambda: len(joints) == COUNT, "all messages")

    assert player.finished.result() == 0
    assert [stamp_of(m) for m in images] == [stamp_of(m) for m in poses] == STAMPS
    rng = np.random.default_rng(3)
    first = decode_image(images[0])
    np.testing.assert_array_equal(first.pixels, rng.integers(0, 256, (40, 60), dtype=np.uint8))
    assert first.frame_id == "camera"
    positions = [decode_joint_state(m).positions[0] for m in joints]
    np.testing.assert_allclose(positions, 0.1 * np.arange(COUNT))


def test_clock_follows_the_recording(graph: Any, bag: Path) -> None:
    clocks = graph.collect(Clock, "/clock")
    graph.collect(Image, "left/image_raw")
    player = graph.add(
        BagPlayerNode, bag=str(bag), rate=2.0, wait_for_subscribers=["left/image_raw", "/clock"]
    )

    graph.spin_until(player.finished.done, "the end of the bag")
    graph.spin_until(lambda: stamp_of(clocks[-1]) >= STAMPS[-1], "the clock of the last message")

    times = [stamp_of(clock) for clock in clocks]
    assert times == sorted(times)
    assert times[0] >= START
    assert len(times) >= COUNT


def test_it_waits_for_its_subscribers(graph: Any, bag: Path) -> None:
    graph.collect(Image, "left/image_raw")
    wanted = ["left/image_raw", "camera_pose"]
    player = graph.add(BagPlayerNode, bag=str(bag), rate=20.0, wait_for_subscribers=wanted)
    diagnosed = graph.tester.get_clock().now()
    graph.spin_until(
        lambda: (graph.tester.get_clock().now() - diagnosed).nanoseconds > SECOND // 2,
        "half a second",
    )
    assert player.health.results() == 0

    poses = graph.collect(PoseWithCovarianceStamped, "camera_pose")

    graph.spin_until(lambda: len(poses) == COUNT, "all poses")


def test_a_topic_given_twice_waits_for_two_subscribers(graph: Any, bag: Path) -> None:
    first = graph.collect(Image, "left/image_raw")
    wanted = ["left/image_raw", "left/image_raw"]
    player = graph.add(BagPlayerNode, bag=str(bag), rate=20.0, wait_for_subscribers=wanted)
    began = graph.tester.get_clock().now()
    graph.spin_until(
        lambda: (graph.tester.get_clock().now() - began).nanoseconds > SECOND // 2, "half a second"
    )
    assert player.health.results() == 0

    second = graph.collect(Image, "left/image_raw")

    graph.spin_until(lambda: len(first) == len(second) == COUNT, "all images for both")


def test_who_comes_late_gets_what_is_latched(graph: Any, bag: Path) -> None:
    joints = graph.collect(JointState, "joint_states")
    graph.add(BagPlayerNode, bag=str(bag), rate=20.0, wait_for_subscribers=["joint_states"])
    graph.spin_until(lambda: joints, "the first joint state")

    texts = graph.collect(String, "robot_description", qos.latched())

    graph.spin_until(lambda: texts, "the robot description")
    assert texts[0].data == "<robot/>"


def test_tf_is_played_where_its_messages_are_installed(graph: Any, bag: Path) -> None:
    player = graph.add(BagPlayerNode, bag=str(bag))

    published = [name for name, _ in graph.tester.get_topic_names_and_types()]
    graph.spin_until(lambda: player.count_publishers("/clock"), "the node")

    installed = find_spec("tf2_msgs") is not None
    assert (player.count_publishers("/tf_static") == 1) is installed
    assert f"{graph.namespace}/tf_static" not in published


def test_looping_jumps_back_to_the_start(graph: Any, bag: Path) -> None:
    joints = graph.collect(JointState, "joint_states", 100)
    graph.add(
        BagPlayerNode, bag=str(bag), rate=20.0, loop=True, wait_for_subscribers=["joint_states"]
    )

    graph.spin_until(lambda: len(joints) >= 2 * COUNT, "two rounds")

    assert [stamp_of(m) for m in joints[: 2 * COUNT]] == STAMPS + STAMPS


def test_acknowledged_play_waits_for_each_result(
    graph: Any, bag: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(player_module, "_ACKNOWLEDGE_TIMEOUT", 60.0)
    images = graph.collect(Image, "left/image_raw")
    results = graph.publisher(PointCloud2, "map_updates")
    player = graph.add(
        BagPlayerNode,
        bag=str(bag),
        acknowledged=True,
        window=1,
        wait_for_subscribers=["left/image_raw"],
    )
    graph.connect(results)
    types = RclpyMessageTypes()
    for index, stamp in enumerate(STAMPS):
        graph.spin_until(lambda count=index + 1: len(images) == count, f"image {index}")
        nothing = PointCloudRecord(stamp, "map", np.zeros((0, 3), np.float32))
        results.publish(encode_point_cloud(types, nothing))

    graph.spin_until(player.finished.done, "the end of the bag")

    assert [stamp_of(m) for m in images] == STAMPS


def test_only_the_wanted_topics_are_played(graph: Any, bag: Path) -> None:
    player = graph.add(BagPlayerNode, bag=str(bag), topics=["/joint_states"])

    published = {
        name
        for name, _ in player.get_publisher_names_and_types_by_node("bag_player", graph.namespace)
    }

    assert f"{graph.namespace}/joint_states" in published
    assert f"{graph.namespace}/left/image_raw" not in published


def test_topics_that_are_left_out_are_not_played(graph: Any, bag: Path) -> None:
    player = graph.add(BagPlayerNode, bag=str(bag), left_out=["/joint_states"])

    published = {
        name
        for name, _ in player.get_publisher_names_and_types_by_node("bag_player", graph.namespace)
    }

    assert f"{graph.namespace}/joint_states" not in published
    assert f"{graph.namespace}/left/image_raw" in published


def test_it_waits_for_who_makes_something_of_the_bag(graph: Any, bag: Path) -> None:
    joints = graph.collect(JointState, "joint_states")
    player = graph.add(BagPlayerNode, bag=str(bag), wait_for_publishers=["result"], rate=100.0)
    started = graph.collect(Clock, "/clock")
    graph.spin_until(lambda: player.count_subscribers(f"{graph.namespace}/joint_states"), "us")
    assert not joints and not started

    graph.publisher(Clock, "result")

    graph.spin_until(lambda: joints, "joint states")


def test_a_truncated_bag_is_played_as_far_as_it_is_whole(graph: Any, bag: Path) -> None:
    (file,) = bag.glob("*.mcap")
    content = file.read_bytes()
    file.write_bytes(content[: int(len(content) * 0.9)])
    joints = graph.collect(JointState, "joint_states")

    player = graph.add(
        BagPlayerNode, bag=str(bag), rate=20.0, wait_for_subscribers=["joint_states"]
    )
    graph.spin_until(player.finished.done, "the end of the bag")

    assert player.finished.result() == 0
    assert player._reader.problems
    graph.spin_until(lambda: joints, "joint states")
    assert [stamp_of(m) for m in joints] == STAMPS[: len(joints)]


@pytest.mark.parametrize("name", ["nowhere", "notes.txt"])
def test_what_is_no_bag_is_refused_by_name(graph: Any, tmp_path: Path, name: str) -> None:
    (tmp_path / "notes.txt").write_text("no bag")

    with pytest.raises(BagError, match=name):
        graph.add(BagPlayerNode, bag=str(tmp_path / name))


def test_an_impossible_rate_is_refused_by_name(graph: Any, bag: Path) -> None:
    with pytest.raises(ConfigError, match="'rate'"):
        graph.add(BagPlayerNode, bag=str(bag), rate=0.0)


def test_a_player_without_a_bag_names_the_parameter(graph: Any) -> None:
    with pytest.raises(ConfigError, match="'bag'"):
        graph.add(BagPlayerNode)
