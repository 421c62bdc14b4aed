"""The topic team/agents as it is heard."""

from __future__ import annotations

from collections.abc import Callable

from visualization_msgs.msg import MarkerArray

from infomap_ros.errors import FrameError
from infomap_ros.messages.agents import decode_agent_texts
from infomap_ros.nodes.common import qos
from infomap_ros.nodes.common.base import MonitoredNode
from infomap_ros.nodes.team.team_topics import AGENTS


def listen_to_agents(node: MonitoredNode, frame: str, hear: Callable[[str], object]) -> None:
    """Subscribe to what robots tell of themselves.

    Args:
        node: that listens; what is refused is counted there.
        frame: of the map.
        hear: called with each text; its errors are counted drops.
    """

    def receive(message: MarkerArray) -> None:
        for told_in, text in decode_agent_texts(message):
            if told_in != frame:
                raise FrameError(f"robot told in frame '{told_in}', the map is '{frame}'")
            hear(text)

    profile = qos.stream(depth=50)
    node.listen(MarkerArray, AGENTS, receive, profile, required=False, from_peer=True)
