"""The robot's description, completed by frames that only /tf_static has."""

from __future__ import annotations

import math
import time
import xml.etree.ElementTree as ET
from collections.abc import Callable, Collection, Iterable, Mapping

from rclpy.impl.rcutils_logger import RcutilsLogger
from scipy.spatial.transform import Rotation
from std_msgs.msg import String

from infomap_ros.geometry import TransformRecord
from infomap_ros.messages import decode_text
from infomap_ros.motion.robot.robot_model import RobotModel
from infomap_ros.nodes.common import qos
from infomap_ros.nodes.common.base import MonitoredNode
from infomap_ros.nodes.robot.odometry_listener import FrameListener


def with_prefix(description: str, prefix: str) -> str:
    """A URDF whose links are called as robot_state_publisher calls their frames.

    Args:
        description: text of the URDF; returned as it is where it cannot be read.
        prefix: put before the name of each link.
    """
    root = _read(description) if prefix else None
    if root is None:
        return description
    for link in root.iter("link"):
        link.set("name", prefix + link.get("name", ""))
    for end in (*root.iterfind("joint/parent"), *root.iterfind("joint/child")):
        end.set("link", prefix + end.get("link", ""))
    return ET.tostring(root, encoding="unicode")


def with_fixed_frames(description: str, chains: Iterable[TransformRecord]) -> str:
    """A URDF with links at frames that only tf has, such as a camera's optical frame.

    Args:
        description: text of the URDF; returned as it is where it cannot be read or lacks nothing.
        chains: the fixed transforms from links of the robot down to these frames.
    """
    added = {edge.child_frame_id: edge for edge in chains}
    root = _read(description) if added else None
    if root is None:
        return description
    for edge in added.values():
        _attach(root, edge)
    return ET.tostring(root, encoding="unicode")


def _read(description: str) -> ET.Element | None:
    """The URDF; None where it is none, which is for its reader to say."""
    try:
        return ET.fromstring(description)
    except ET.ParseError:
        return None


def _chain(
    frame: str, edges: Mapping[str, TransformRecord], links: Collection[str]
) -> list[TransformRecord]:
    """The transforms from a link down to a frame, none where there is no such path."""
    chain: list[TransformRecord] = []
    while frame not in links:
        edge = edges.get(frame)
        if edge is None or len(chain) > len(edges):
            return []
        chain.append(edge)
        frame = edge.frame_id
    return chain[::-1]


def _attach(root: ET.Element, edge: TransformRecord) -> None:
    """Add a link that is fixed to another."""
    ET.SubElement(root, "link", name=edge.child_frame_id)
    joint = ET.SubElement(root, "joint", name=f"{edge.child_frame_id}_by_tf", type="fixed")
    ET.SubElement(joint, "parent", link=edge.frame_id)
    ET.SubElement(joint, "child", link=edge.child_frame_id)
    angles = Rotation.from_matrix(edge.transform[:3, :3]).as_euler("xyz")
    values = {"xyz": edge.transform[:3, 3], "rpy": angles}
    texts = {name: " ".join(repr(float(each)) for each in value) for name, value in values.items()}
    ET.SubElement(joint, "origin", texts)


_PERIOD = 1.0  # [s]


class DescriptionListener:
    """Listens to robot_description and /tf_static.

    Drivers of cameras publish the optical frames, which descriptions of robots often lack.

    Args:
        node: that listens.
        on_description: called with the text of the URDF, again when a frame was added.
        prefix: put before the names of its links.
        required: whether the node cannot work without it.
        on_edge: called with each transform that is received.

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
        self._links: Collection[str] = ()
        self._sent: list[tuple[str, str, bytes]] | None = None
        self._wanted: set[str] = set()
        self._next = -math.inf  # when an edge may change what was sent [s]
        node.listen(String, "robot_description", self._on_text, qos.latched(), required=required)
        self.frames = FrameListener(node, self._on_edge)
        node.repeat(_PERIOD, self._look)

    def want(self, frame: str) -> None:
        """Have a frame in the description, as soon as tf has it."""
        if frame and frame not in self._wanted:
            self._wanted.add(frame)
            self._notify()

    def _on_text(self, message: String) -> None:
        self.published = decode_text(message).text
        self._text, self._sent = with_prefix(self.published, self._prefix), None
        root = _read(self._text)
        links = () if root is None else root.iterfind("link")
        self._links = {link.get("name", "") for link in links}
        self._notify()

    def _on_edge(self, edge: TransformRecord) -> None:
        if edge.is_static:
            self._look()
        self._pass_on(edge)

    def _look(self) -> None:
        """See whether tf has another one, at most once a second: publishers may differ."""
        for child, *_ in self._sent or ():
            self.frames.use(child)
        if time.monotonic() >= self._next:
            self._notify()

    def _notify(self) -> None:
        """Pass on the description, where it is another than last."""
        if self._text is None:
            return
        edges = self.frames.static
        chain = [e for frame in sorted(self._wanted) for e in _chain(frame, edges, self._links)]
        before = self._sent
        self._sent = [(e.child_frame_id, e.frame_id, e.transform.tobytes()) for e in chain]
        if self._sent != before:
            if before is not None:
                self._next = time.monotonic() + _PERIOD
            self._on_description(with_fixed_frames(self._text, chain))


def warn_of_left_out(log: RcutilsLogger, robot: RobotModel) -> None:
    """Say which shapes of a robot are not known: what they hide or touch is not looked after."""
    for sentence in robot.left_out:
        log.warning(f"left out of the robot: {sentence}")
