"""Frames of several robots in one graph."""

from __future__ import annotations

from functools import partial
from types import SimpleNamespace
from typing import Any

import numpy as np

from infomap_ros.geometry import OdometryRecord, TransformRecord
from infomap_ros.geometry.resources import find_share
from infomap_ros.messages import TF, decode_transforms
from infomap_ros.nodes.common import qos
from infomap_ros.nodes.common.base import MonitoredNode
from infomap_ros.nodes.common.message_types import message_class
from infomap_ros.nodes.locating.localization_outputs import LocalizationOutputs
from infomap_ros.nodes.simulated.simulator_frames import SimulatorFrames
from infomap_ros.nodes.team.team_topics import OWN_FRAMES

DESCRIPTION = find_share("config/rover.urdf").read_text("utf-8")


class FramesNode(MonitoredNode):
    """Publishes all frames of a robot: of its links, of odometry and of the map."""

    def __init__(self, **arguments: Any) -> None:
        super().__init__("frames", **arguments)
        simulator: Any = SimpleNamespace(
            description=DESCRIPTION, stamp=1, frame=lambda name: np.eye(4)
        )
        self.frames = SimulatorFrames(self, simulator)
        self.outputs = LocalizationOutputs(self, "map", publish_tf=True)

    def publish(self, x: float) -> None:
        pose = np.eye(4)
        pose[0, 3] = x
        self.frames.publish(OdometryRecord(2, "odom", pose, None, "base_link"))
        self.outputs.publish_frame(TransformRecord(2, "map", "odom", pose))


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
