"""The transform from the map to the frame of odometry, as those who drive by tf need it (REP-105).

tf refuses a transform that is newer than the newest that it has heard. An image is old when its
pose is known, and the next pose comes a period later; so the transform is stamped ahead by a
tolerance and told again, with a later stamp, until there is a newer one. It is nearly constant:
odometry does the moving in between.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import dataclass, replace

from infomap_ros.geometry import TransformRecord
from infomap_ros.geometry.config import check_config, parameter
from infomap_ros.messages import TF, encode_transforms
from infomap_ros.nodes.common import qos
from infomap_ros.nodes.common.base import MonitoredNode
from infomap_ros.nodes.common.message_types import RclpyMessageTypes, message_class

PERIOD = 0.05
"""Between two publications [s]: controllers and costmaps of Nav2 look up at 5 to 20 Hz."""


_LATE = 1_000_000_000
"""By how much the stamp of a pose may be behind what was told [ns]: more is a clock that jumped."""


@dataclass(frozen=True)
class MapFrameConfig:
    """How the map's place in tf is told.

    Raises:
        ConfigError: a value is out of its range.
    """

    publish_tf: bool = parameter(
        True,
        "Publish /tf: map to the frame of odometry, or where there is no odometry to the topmost "
        "frame above the camera.",
    )
    transform_tolerance: float = parameter(
        0.5,
        "The transform from map to odometry, published at 20 Hz, is stamped so far ahead of its "
        "image: longer than from an image to its pose, so that users of tf need not wait.",
        unit="s",
        low=0.0,
        high=10.0,
    )

    def __post_init__(self) -> None:
        check_config(self)


def frame_publisher(node: MonitoredNode) -> Callable[[TransformRecord], None]:
    """What publishes a transform on /tf; nothing where that is not wanted or has no messages.

    Args:
        node: has a `MapFrameConfig`.
    """
    if not node.config(MapFrameConfig).publish_tf:
        return lambda _: None
    try:
        publisher = node.advertise(message_class(TF), "/tf", qos.stream(depth=100))
    except ModuleNotFoundError:
        node.get_logger().warning("no /tf: tf2_msgs is not installed")
        return lambda _: None
    types = RclpyMessageTypes()
    return lambda edge: publisher.publish(encode_transforms(types, [edge]))


class OdomFrameBroadcaster:
    """Publishes the newest transform again and again. May be used by any thread.

    Between poses, time goes on by the node's clock; where that stands (a simulator or bag that is
    paused) or jumps back, nothing is repeated.

    Args:
        node: whose clock and timer are used.
        publish: sends one transform.
        tolerance: how far a stamp is ahead of its time [s].
    """

    def __init__(
        self, node: MonitoredNode, publish: Callable[[TransformRecord], None], tolerance: float
    ) -> None:
        self._node, self._publish, self._ahead = node, publish, round(1e9 * tolerance)
        self._lock = threading.Lock()
        self._edge: TransformRecord | None = None
        self._begin = self._told = 0  # [ns]
        node.repeat(PERIOD, self._repeat)

    def update(self, edge: TransformRecord) -> None:
        """Publish a transform, and from now on this one.

        Args:
            edge: the map to odometry, at the stamp of its image.
        """
        with self._lock:
            self._edge, self._begin = edge, self._now()
            stamp = edge.stamp + self._ahead
            if not 0 <= self._told - stamp < _LATE:  # else it is told as soon as time has gone on
                self._send(stamp)

    def _repeat(self) -> None:
        with self._lock:
            if self._edge is None:
                return
            stamp = self._edge.stamp + self._ahead + self._now() - self._begin
            if stamp > self._told:
                self._send(stamp)

    def _send(self, stamp: int) -> None:
        if self._edge is not None:
            self._told = stamp
            self._publish(replace(self._edge, stamp=stamp))

    def _now(self) -> int:
        return int(self._node.get_clock().now().nanoseconds)
