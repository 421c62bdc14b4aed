"""The frame that the map is told to be above of, where there is no odometry."""

from __future__ import annotations

import math
import threading
import time

from rclpy.clock import Clock, ClockType

from infomap_ros.errors import FrameError, PoseUnavailableError
from infomap_ros.geometry import PoseRecord, TransformRecord, invert_transform
from infomap_ros.geometry.transform_tree import TransformTree
from infomap_ros.nodes.common.base import MonitoredNode
from infomap_ros.nodes.robot.frame_listener import FrameListener

_LOOK_PERIOD = 0.1  # [s]
_DISCOVERY = 0.5  # [s], in which publishers of /tf are found


class CameraRoot:
    """Finds the topmost frame above the camera in tf: it gets the map as its parent.

    A frame has one parent only, so that a camera on a robot, whose description says where it is,
    must not be placed itself. /tf is heard from when this is asked for. May be used by any thread.

    Args:
        node: that listens.
        map_frame: name of the map's frame.
    """

    def __init__(self, node: MonitoredNode, map_frame: str) -> None:
        self._node, self._map = node, map_frame
        self._lock = threading.Lock()
        self._tree = TransformTree()
        self._own: set[str] = set()
        self._is_placed = self._is_needed = False
        self._since = math.inf
        self._frames = FrameListener(node, self._on_edge)
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        node.create_timer(_LOOK_PERIOD, self._look, clock=steady)

    def note_own(self, child: str) -> None:
        """This node itself places a frame in the map."""
        with self._lock:
            self._own.add(child)

    def below_map(self, camera: PoseRecord) -> TransformRecord | None:
        """The transform that places the camera in the map.

        Args:
            camera: its pose in the map.

        Returns:
            The map to the topmost frame above the camera, which may be the camera itself; None
            where somebody else has placed that, or tf does not tell where the camera is on it at
            that time.
        """
        with self._lock:
            self._is_needed = True
            if self._is_placed or time.monotonic() < self._since + _DISCOVERY:
                return None
            try:
                root = self._tree.root_of(camera.child_frame_id)
                on_root = self._tree.at(root, camera.child_frame_id, camera.stamp).transform
            except (FrameError, PoseUnavailableError):
                return None
            self._own.add(root)
        T_map_root = camera.transform @ invert_transform(on_root)
        return TransformRecord(camera.stamp, self._map, root, T_map_root)

    def _look(self) -> None:
        if self._is_needed and self._since == math.inf:
            self._frames.hear_moving()
            self._since = time.monotonic()

    def _on_edge(self, edge: TransformRecord) -> None:
        with self._lock:
            if edge.frame_id != self._map:
                self._tree.add_transform(edge)
            elif edge.child_frame_id not in self._own and not self._is_placed:
                self._is_placed = True
                text = f"somebody else places '{edge.child_frame_id}' in '{self._map}' on /tf"
                self._node.get_logger().warning(f"{text}: this node does not")
