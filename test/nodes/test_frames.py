"""Frames of several robots in one graph."""

from __future__ import annotations

import time
from functools import partial
from types import SimpleNamespace
from typing import Any

import numpy as np

from infomap_ros.geometry import OdometryRecord, PoseRecord, TransformRecord, make_transform
from infomap_ros.geometry.resources import find_share
from infomap_ros.messages import TF, decode_transforms, encode_transforms
from infomap_ros.nodes.common import qos
from infomap_ros.nodes.common.base import MonitoredNode
from infomap_ros.nodes.common.message_types import RclpyMessageTypes, message_class
from infomap_ros.nodes.locating.base_topics import (
    MapFrameConfig,
    OdomFrameBroadcaster,
    frame_publisher,
)
from infomap_ros.nodes.locating.localization_outputs import CameraRoot
from infomap_ros.nodes.simulated.simulator_outputs import SimulatorFrames
from infomap_ros.nodes.team.team_topics import OWN_FRAMES

DESCRIPTION = find_share("config/rover.urdf").read_text("utf-8")


class FramesNode(MonitoredNode):
    """Publishes all frames of a robot: of its links, of odometry and of the map."""

    CONFIGS = ((MapFrameConfig, ""),)

    def __init__(self, **arguments: Any) -> None:
        super().__init__("frames", **arguments)
        simulator: Any = SimpleNamespace(
            description=DESCRIPTION, stamp=1, frame=lambda name: np.eye(4)
        )
        self.frames = SimulatorFrames(self, simulator)
        self.publish_frame = frame_publisher(self)

    def publish(self, x: float) -> None:
        pose = np.eye(4)
        pose[0, 3] = x
        self.frames.publish(OdometryRecord(2, "odom", pose, None, "base_link"))
        self.publish_frame(TransformRecord(2, "map", "odom", pose))


def test_frames_of_two_robots_do_not_meet(graph: Any) -> None:
    remaps = [f"{source}:={target}" for source, target in OWN_FRAMES.items()]
    heard: dict[str, list[Any]] = {}
    for x, name in enumerate(("robot1", "robot2")):
        space = f"{graph.namespace}/{name}"
        for topic, profile in (("tf", qos.stream(100)), ("tf_static", qos.latched())):
            heard[f"{name}/{topic}"] = graph.collect(message_class(TF), f"{space}/{topic}", profile)
        given = [part for remap in (f"__ns:={space}", *remaps) for part in ("-r", remap)]
        node = graph.add(partial(FramesNode, cli_args=["--ros-args", *given]))
        graph.spin_until(lambda node=node: node.count_subscribers("tf"), "the listener")
        node.publish(1.0 + x)
    graph.spin_until(lambda: all(heard.values()), "all frames")

    for topic in ("/tf", "/tf_static"):
        assert graph.tester.count_publishers(topic) == 0
    for x, name in enumerate(("robot1", "robot2")):
        graph.spin_until(lambda name=name: len(heard[f"{name}/tf"]) == 2, "odom and map")
        messages = heard[f"{name}/tf"] + heard[f"{name}/tf_static"]
        edges = [edge for message in messages for edge in decode_transforms(message)]
        children = [edge.child_frame_id for edge in edges]
        assert len(set(children)) == len(children)  # no frame has two parents
        assert {"odom", "base_link", "left_camera_optical_frame"} <= set(children)
        (odom,) = [edge for edge in edges if edge.child_frame_id == "odom"]
        assert odom.transform[0, 3] == 1.0 + x


def broadcast(graph: Any, **values: Any) -> tuple[OdomFrameBroadcaster, list[TransformRecord]]:
    sent: list[TransformRecord] = []
    node = graph.add(partial(MonitoredNode, "broadcaster"), **values)
    return OdomFrameBroadcaster(node, sent.append, 0.5), sent


def map_to_odom(stamp: int) -> TransformRecord:
    return TransformRecord(stamp, "map", "odom", np.eye(4))


def test_the_map_is_told_where_odometry_is_until_there_is_news(graph: Any) -> None:
    """As tf needs it: at any time there is a transform that is not older than now."""
    broadcaster, sent = broadcast(graph)
    first = graph.tester.get_clock().now().nanoseconds - 200_000_000  # an image of 0.2 s ago
    broadcaster.update(map_to_odom(first))
    assert [edge.stamp for edge in sent] == [first + 500_000_000]

    def is_covered() -> bool:
        return sent[-1].stamp >= graph.tester.get_clock().now().nanoseconds

    begin = time.monotonic()
    graph.spin_until(lambda: len(sent) > 20, "the same transform again")
    assert is_covered()
    assert time.monotonic() - begin > 0.8  # 20 Hz, not more
    stamps = [edge.stamp for edge in sent]
    assert sorted(set(stamps)) == stamps  # tf wants each stamp once

    news = graph.tester.get_clock().now().nanoseconds
    broadcaster.update(map_to_odom(news))
    assert sent[-1].stamp == news + 500_000_000


def test_stamps_do_not_step_back_where_a_pose_took_longer(graph: Any) -> None:
    broadcaster, sent = broadcast(graph)
    for age in (0.1, 0.3, 0.05, 0.2):  # [s] of an image when its pose is known
        stamp = graph.tester.get_clock().now().nanoseconds - round(1e9 * age)
        edge = map_to_odom(stamp)
        edge.transform[0, 3] = age
        broadcaster.update(edge)
        graph.spin_until(lambda age=age: sent[-1].transform[0, 3] == age, "the news")
    stamps = [edge.stamp for edge in sent]
    assert sorted(set(stamps)) == stamps


def test_a_clock_that_was_set_back_begins_anew(graph: Any) -> None:
    broadcaster, sent = broadcast(graph, use_sim_time=True)
    for second in (30, 7):
        broadcaster.update(map_to_odom(second * 10**9))
    assert [edge.stamp for edge in sent] == [30_500_000_000, 7_500_000_000]


def test_while_the_clock_stands_nothing_is_repeated(graph: Any) -> None:
    broadcaster, sent = broadcast(graph, use_sim_time=True)
    broadcaster.update(map_to_odom(7))
    begin = time.monotonic()
    graph.spin_until(lambda: time.monotonic() - begin > 0.4, "eight periods")
    assert len(sent) == 1


def test_without_odometry_the_map_is_above_the_robot_and_no_frame_has_two_parents(
    graph: Any,
) -> None:
    node = graph.add(partial(MonitoredNode, "locates"))
    root = CameraRoot(node, "map")
    static = graph.tester.create_publisher(message_class(TF), "/tf_static", qos.latched())
    moving = graph.tester.create_publisher(message_class(TF), "/tf", qos.stream())
    mount, arm = make_transform(np.eye(3), [0.1, 0, 0]), make_transform(np.eye(3), [0, 0, 0.7])
    types = RclpyMessageTypes()
    static.publish(encode_transforms(types, [TransformRecord(0, "hand", "optical", mount, True)]))
    pose = PoseRecord(5, "map", make_transform(np.eye(3), [3.0, 2.0, 1.0]), None, "optical")

    def found() -> TransformRecord | None:
        moving.publish(encode_transforms(types, [TransformRecord(5, "base_link", "hand", arm)]))
        return root.below_map(pose)

    graph.spin_until(lambda: (edge := found()) and edge.child_frame_id == "base_link", "the base")
    edge = found()
    assert edge is not None
    assert (edge.stamp, edge.frame_id) == (5, "map")
    np.testing.assert_allclose(edge.transform[:3, 3], [2.9, 2.0, 0.3], atol=1e-12)

    moving.publish(encode_transforms(types, [TransformRecord(6, "map", "odom", np.eye(4))]))
    graph.spin_until(lambda: root.below_map(pose) is None, "another who places the robot")
