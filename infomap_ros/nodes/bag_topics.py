"""The topics onto which a bag is played."""

from __future__ import annotations

from collections.abc import Collection

from rclpy.publisher import Publisher

from infomap_ros.errors import BagError
from infomap_ros.nodes.common import qos
from infomap_ros.nodes.common.base import MonitoredNode
from infomap_ros.nodes.common.message_types import message_class
from infomap_ros.replay.bags.reader import BagReader

_ABSOLUTE = ("/tf", "/tf_static", "/diagnostics")
_NOT_PLAYED = ("/clock", "/rosout", "/parameter_events")


def advertise_topics(
    node: MonitoredNode, bag: BagReader, wanted: Collection[str]
) -> dict[str, Publisher]:
    """Make a publisher for each topic of a bag whose message type is installed.

    Names become relative, so that namespace and remaps apply, except those that are absolute in
    every graph. What is latched in the bag is latched again. A topic whose type is not installed
    is named in the log and left out.

    Args:
        node: that publishes.
        bag: the bag.
        wanted: topics as they are in the bag.

    Returns:
        Publishers by the topics of the bag.

    Raises:
        BagError: no topic is left.
    """
    publishers = {}
    for name, channel in bag.topics.items():
        if name in _NOT_PLAYED or name not in wanted:
            continue
        try:
            kind = message_class(channel.type_name)
        except (ModuleNotFoundError, AttributeError):
            text = f"{name} is not played: {channel.type_name} is not installed"
            node.get_logger().warning(text)
            continue
        profile = qos.latched(depth=100) if channel.latched else qos.stream(depth=20)
        target = name if name in _ABSOLUTE else name.lstrip("/")
        publishers[name] = node.advertise(kind, target, profile)
    if not publishers:
        raise BagError(f"{bag.path} holds no topic to play")
    return publishers
