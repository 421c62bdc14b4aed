"""The robot's description, completed by frames that only /tf_static tells."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from rclpy.impl.rcutils_logger import RcutilsLogger
from std_msgs.msg import String

from infomap_ros.geometry import TransformRecord
from infomap_ros.messages import decode_text
from infomap_ros.motion import RobotModel
from infomap_ros.nodes.common import qos
from infomap_ros.nodes.common.base import MonitoredNode
from infomap_ros.nodes.robot.frame_listener import FrameListener
from infomap_ros.pipeline.described_frames import (
    fixed_chains,
    links_of,
    with_fixed_frames,
    with_prefix,
)


class DescriptionListener:
    """Listens to robot_description and /tf_static.

    Drivers of cameras publish the optical frames, which descriptions of robots often lack.

    Args:
        node: that listens.
        on_description: told the text of the URDF, again when a frame was added.
        prefix: put before the names of its links.
        required: whether the node cannot work without it.
        on_edge: told of each transform that is heard.

    Attributes:
        published: what stands on robot_description; empty before it has come.
    """

    def __init__(
        self,
        node: MonitoredNode,
        on_description: Callable[[str], None],
        prefix: str = "",
        *,
        required: bool = True,
        on_edge: Callable[[TransformRecord], None] = lambda _: None,
    ) -> None:
        self._on_description, self._prefix, self._pass_on = on_description, prefix, on_edge
        self.published = ""
        self._text: str | None = None
        self._links: frozenset[str] = frozenset()
        self._told: list[TransformRecord] | None = None
        self._wanted: set[str] = set()
        self._edges: dict[str, TransformRecord] = {}
        node.listen(String, "robot_description", self._on_text, qos.latched(), required=required)
        self.frames = FrameListener(node, self._on_edge)

    def want(self, frame: str) -> None:
        """Have a frame in the description, as soon as tf tells where it is."""
        if frame and frame not in self._wanted:
            self._wanted.add(frame)
            self._tell()

    def _on_text(self, message: String) -> None:
        self.published = decode_text(message).text
        self._text, self._told = with_prefix(self.published, self._prefix), None
        self._links = links_of(self._text)
        self._tell()

    def _on_edge(self, edge: TransformRecord) -> None:
        if edge.is_static:
            self._edges[edge.child_frame_id] = edge
            self._tell()
        self._pass_on(edge)

    def _tell(self) -> None:
        """Tell the description, where it is another than was told last."""
        if self._text is None:
            return
        chain = fixed_chains(self._edges, sorted(self._wanted), self._links)
        if self._told is None or not _are_same(chain, self._told):
            self._told = chain
            self._on_description(with_fixed_frames(self._text, chain))


def warn_of_left_out(log: RcutilsLogger, robot: RobotModel) -> None:
    """Say which shapes of a robot are not known: what they hide or touch is not looked after."""
    for sentence in robot.left_out:
        log.warning(f"left out of the robot: {sentence}")


def _are_same(first: list[TransformRecord], second: list[TransformRecord]) -> bool:
    """Whether chains lead by the same frames and transforms."""
    return len(first) == len(second) and all(
        (a.child_frame_id, a.frame_id) == (b.child_frame_id, b.frame_id)
        and np.array_equal(a.transform, b.transform)
        for a, b in zip(first, second, strict=True)
    )
