"""What can be wrong with the connections of a live graph."""

from __future__ import annotations

from rclpy.node import Node
from rclpy.qos import QoSCompatibility, qos_check_compatible

from infomap_ros.nodes.diagnosis.findings import Finding


def similar_topics(node: Node, topic: str, type_name: str) -> list[str]:
    """Published topics that may be what is missing, the likeliest first.

    Args:
        node: through which the graph is seen.
        topic: relative name of what is missing, for example ``left/image_rect``.
        type_name: its type.
    """
    full = node.resolve_topic_name(topic)
    side, _, tail = topic.rpartition("/")
    found = [
        name
        for name, types in node.get_topic_names_and_types()
        if type_name in types and name != full and side in name and node.count_publishers(name)
    ]
    return sorted(found, key=lambda name: (tail not in name, name))


def unconnected(node: Node) -> list[Finding]:
    """Publishers and subscribers of one topic whose quality of service keeps them apart.

    Args:
        node: through which the graph is seen.
    """
    found = []
    for name, _ in node.get_topic_names_and_types():
        for publisher in node.get_publishers_info_by_topic(name):
            for subscriber in node.get_subscriptions_info_by_topic(name):
                profiles = publisher.qos_profile, subscriber.qos_profile
                verdict, reason = qos_check_compatible(*profiles)
                if verdict == QoSCompatibility.ERROR:
                    pair = f"{publisher.node_name} -> {subscriber.node_name}"
                    found.append(Finding(False, name, f"{pair} never connect: {reason}"))
    return found
